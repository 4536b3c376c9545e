"""Simulation of beds of repelling magnets between two glass plates, and of the piston on them.

>>> from granular import load_scene, simulate
>>> run = simulate(load_scene("damper"))
>>> record = run.piston()
"""

import lazy_loader

from granular.shared.errors import with_advice

# Names, which stand in __init__.pyi, are imported when they are used: importing the package costs
# next to nothing.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = with_advice(__getattr__)
