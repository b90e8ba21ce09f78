"""Scenes: obstacles with their shapes and poses, and the points that are dangerous to approach."""
