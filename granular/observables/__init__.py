"""Observables of a bed: structure, forces, energies and the response to a drive.

Functions of plain arrays (positions, diameters, forces; SI) return numbers, arrays or named tuples.
`per_frame` evaluates a function of a `Frame` at every frame of a run, and returns labelled values with their
unit. `per_lag` does the same for functions of the time between frames, and `per_distance` for functions of
the distance between two grains. Grains whose position is NaN have left the cell and are ignored.
`granular.observables.plots` draws the results.
"""

import lazy_loader

# The names listed in __init__.pyi are imported when first used, so that importing the package costs almost
# nothing.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
