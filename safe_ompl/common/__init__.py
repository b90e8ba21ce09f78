"""Code that all packages use: array types, validation of input, errors, documents, files and worker processes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
