"""Sections of a scene that check themselves, their quantities, units and natural scales."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
