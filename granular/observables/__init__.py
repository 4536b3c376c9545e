"""What is measured in a bed: structure, forces, energies and the answer to a drive.

Every observable has two layers. Functions of plain arrays (positions, diameters, forces) return
arrays or named tuples; functions of a `granular.Trajectory`, whose names end in ``_series`` or
``_of_run``, return labelled xarray objects with units. Grains whose position is NaN have left the
cell and count nowhere. `granular.observables.plots` draws the results.
"""

import lazy_loader

# Names, which stand in __init__.pyi, are imported when they are used: importing the package costs
# next to nothing.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
