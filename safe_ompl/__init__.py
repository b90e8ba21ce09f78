"""Safety-oriented robot arm motion planning for OMPL (Lacevic & Rocco, Robotica 2013)."""

from importlib.machinery import PathFinder

import lazy_loader

from safe_ompl.version import __version__ as __version__

if PathFinder.find_spec("memoryviews", [f"{__path__[0]}/common"]) is None:
    raise ImportError(f"{__path__[0]} holds no modules compiled for this Python: in the checkout, run pip install -e .")

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
