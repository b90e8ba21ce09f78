"""Motions in joint space: limits, proofs of safety, repair, and time laws that stop the robot in time for people."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
