"""Laws of a piston's motion, one a file, and what can be done with any law."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
