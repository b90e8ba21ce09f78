"""Runs of planners, campaigns of them, and benchmarks in OMPL's form."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
