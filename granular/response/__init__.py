"""Response of a machine (the host of a damper) to a harmonic drive or an impulse."""

import lazy_loader

# The names listed in __init__.pyi are imported when first used, so that the command line starts quickly.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
