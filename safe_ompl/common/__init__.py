"""Shared by all packages: array types, checks of input, errors, documents, and models that threads share."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
