"""Read scenes of MoveIt and models of MuJoCo, and prove convex decompositions of meshes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
