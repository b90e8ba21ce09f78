"""Tasks: motions of the tool along curves, proven to stay in a corridor, and programs of many steps."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
