"""Subclasses of OMPL's interfaces: state validity checkers, motion validators, objectives and goals."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
