"""Trajectories: paths in time, within limits, and no faster than what is proven to stop before it reaches anyone."""
