"""Proof of the toolkit's numbers: convergence, energy, cost of accuracy, hard cases, one report.

>>> from validation import cheapest
>>> choice = cheapest(scene, "rest height", 0.01)
>>> run = simulate(scene.replace(**choice.changes), **choice.keywords)
"""

import lazy_loader

# Names, which stand in __init__.pyi, are imported when they are used: importing the package costs
# next to nothing.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
