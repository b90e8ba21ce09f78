"""Motions: what they must keep to, proofs of them, repair, and time laws with stops before people."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
