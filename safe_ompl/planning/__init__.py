"""Planning: `SafeSetup`, an OMPL SimpleSetup for a robot in a scene, and the results of planning."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
