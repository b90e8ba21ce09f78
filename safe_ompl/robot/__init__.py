"""Robots based on Pinocchio: loading, forward and inverse kinematics, and motion bounds."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
