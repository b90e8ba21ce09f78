"""The joints of a robot: which move, how they follow each other, their frames, the skeleton they span."""
