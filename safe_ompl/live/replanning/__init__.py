"""Replanning among people who move. The motion of every tick is proven before the robot executes it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
