"""What others write: scenes and worlds of MoveIt and MuJoCo, and convex pieces of meshes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
