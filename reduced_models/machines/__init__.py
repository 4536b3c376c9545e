"""The identified law coupled to a machine: fast prediction of its response, and design of a damper for it."""

import lazy_loader

# Names, declared in __init__.pyi, are imported at first use.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
