"""People as sensors see them: skeletons of key points, tracking, and where a body may soon be."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
