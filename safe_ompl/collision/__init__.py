"""Collision, distance and margin queries with coal, proofs of whole motions, and bubbles."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
