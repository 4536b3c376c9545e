"""Simulation of beds of repelling magnets between two glass plates, and of the piston on them.

>>> from granular import load_scene, simulate
>>> run = simulate(load_scene("damper"))
>>> record = run.piston()

Each folder knows those before it. ``shared`` is what all need; ``formulas`` reads text,
``compiled`` compiles kernels, ``schema`` holds sections with their units, ``records`` read records.
``pairs`` sums over pairs and ``kernel_data`` is what kernels see; on these stand the ``effects``,
the stages of a ``protocol`` and the ``methods`` of integration, and on them the ``engine``, one
compiled loop. A ``scene`` names what acts, and becomes the engine's constants; a ``run`` goes
through its stages and keeps what happens. ``observables`` measure a run, ``studies`` make many,
``export`` and ``render`` write files and pictures, ``response`` is that to a shaker; ``commands``
call all these.
"""

import lazy_loader

from granular.shared.errors import with_missing_package_advice

# Names, which stand in __init__.pyi, are imported when they are used: importing the package costs
# next to nothing.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = with_missing_package_advice(__getattr__)
