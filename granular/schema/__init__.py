"""Scene sections with built-in checks, the kinds and units of their quantities, and the natural units."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
