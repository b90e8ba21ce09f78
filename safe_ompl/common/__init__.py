"""Shared by all rooms: array types, checks of input, errors, documents, what models share, compiled kernels."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
