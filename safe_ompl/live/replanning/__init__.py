"""Replanning beside people who move: what is driven is proven at every tick."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
