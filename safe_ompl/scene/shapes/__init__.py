"""Shapes of obstacles: basic solids, meshes, point clouds, people."""
