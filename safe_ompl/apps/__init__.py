"""Programs: the command line, benchmarks, file exchange with other tools, and proofs in pytest."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
