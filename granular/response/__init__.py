"""Response of a machine (the host of a damper) to what shakes it."""

import lazy_loader

# Names, which stand in __init__.pyi, are imported when they are used: the command costs nothing before.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
