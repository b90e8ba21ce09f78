"""What OMPL is given: validity, motion validity, objectives, goals, and the bridge between states and arrays."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
