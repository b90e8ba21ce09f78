"""Safety-oriented robot arm motion planning for OMPL (Lacevic & Rocco, Robotica 2013)."""

import lazy_loader

from safe_ompl.version import __version__ as __version__

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
