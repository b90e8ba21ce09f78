"""Graphs that planners search: roadmaps, volume trees of bubbles, and what is handed out of them."""
