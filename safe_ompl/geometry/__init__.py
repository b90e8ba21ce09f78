"""Geometry: poses, shapes, obstacles, point clouds, convex hulls, and bounds of distances between convex bodies."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
