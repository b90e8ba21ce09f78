"""Live data about people: skeletons of key points, tracking, and the sets that a body can reach within a time."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
