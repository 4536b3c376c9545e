"""Simulation of beds of repelling magnets between two glass plates, with a piston on top.

>>> from granular import load_scene, simulate
>>> run = simulate(load_scene("damper"))
>>> record = run.piston()

Each folder imports only folders listed before it. ``shared`` is common code; ``formulas`` parses formulas,
``compiled`` compiles kernels, ``schema`` defines sections with units, ``records`` reads records. ``pairs``
has the pair sums and ``kernel_data`` the data of the kernels. They are used by the ``effects``, the stages of
a ``protocol`` and the integration ``methods``, and these by the ``engine``, one compiled loop. A ``scene``
lists effects and parameters, and is converted to the engine's constants; a ``run`` advances through its
stages and stores records. ``observables`` evaluates runs, ``studies`` makes series of runs, ``export`` and
``render`` write files and pictures, ``response`` computes the response to a shaker; ``commands`` is the
command line.
"""

import lazy_loader

from granular.shared.errors import with_missing_package_advice

# The names in __init__.pyi are imported on first use, so importing the package takes almost no time.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = with_missing_package_advice(__getattr__)
