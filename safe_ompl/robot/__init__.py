"""Robots on Pinocchio: loading, kinematics, inverse kinematics, and how far bodies can move."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
