"""Danger-aware simplification of paths, validation of paths, and reports on paths."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
