"""Laws of a piston's motion, one per file, and the functions that apply to any law."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
