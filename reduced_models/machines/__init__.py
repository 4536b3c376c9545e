"""The identified law at work on a machine: responses in milliseconds, and designs from them."""

import lazy_loader

# Names, which stand in __init__.pyi, are imported when they are used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
