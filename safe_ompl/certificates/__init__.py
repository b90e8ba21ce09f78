"""Certificates of paths and motions: their claims, how they are issued, and how independent code verifies them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
