"""Observables of a bed: structure, forces, energies and the response to a drive.

Functions of plain arrays (positions, diameters, forces; SI) return numbers, arrays or named tuples.
`per_frame` has the values of a function of a `Frame` at every frame of a run, labelled and with its
unit; `per_lag` those of a function of the time between frames, `per_distance` those of a function
of the distance of two grains. Grains whose position is NaN have left the cell and count nowhere.
`granular.observables.plots` draws the results.
"""

import lazy_loader

# Names, which stand in __init__.pyi, are imported when they are used: importing the package costs
# next to nothing.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
