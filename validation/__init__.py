"""Proof of the toolkit's numbers: convergence, energy, cost of accuracy, hard cases, one report.

>>> from validation import recommend_settings
>>> found = recommend_settings(scene, "rest height", 0.01)
>>> run = simulate(scene.replace(**found.changes), **found.keywords)
"""

import lazy_loader

# Names, which stand in __init__.pyi, are imported when they are used: importing the package costs
# next to nothing.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
