"""Sections of a scene with checked values, the kinds and units of their fields, and natural units."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
