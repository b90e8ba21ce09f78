"""Results, paths, scenes and robots as files: one versioned JSON form, and the forms of others by their endings."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
