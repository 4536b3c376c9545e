"""The scene: a frozen, validated, plain description of a bed, its piston and what happens."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
