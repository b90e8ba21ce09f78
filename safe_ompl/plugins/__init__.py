"""Plug-ins for OMPL: validity, motion, objective, goals and the bridge between states and arrays."""
