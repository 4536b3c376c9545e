"""The law of a bed coupled to a machine: fast prediction of the response, and design of a damper."""

import lazy_loader

# Names, declared in __init__.pyi, are imported at first use.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
