"""The case studies of Lacevic & Rocco (2013), run again: the parts of bench/paper.py."""
