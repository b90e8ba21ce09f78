"""Danger field of a robot at rest and in motion, its gradients, and proven bounds."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
