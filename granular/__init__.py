"""Simulation of beds of repelling disc magnets between two glass plates, with a piston on top.

>>> from granular import load_scene, simulate
>>> run = simulate(load_scene("damper"))
>>> record = run.piston()

Each folder imports only folders listed before it:

- ``shared``: common code; ``formulas``: the parser of formulas; ``compiled``: the compiler of the loop;
  ``schema``: sections of scenes with units; ``records``: recorded motions;
- ``pairs``: pair sums; ``kernel_data``: data of the compiled loop;
- ``effects``: physical laws; ``protocol``: stages of a run; ``methods``: integrators;
- ``engine``: the compiled loop; ``scene``: the description of a bed; ``run``: runs through all stages;
- ``observables``: evaluation of runs; ``studies``: series of runs; ``export`` and ``render``: files and
  pictures; ``response``: the response to a shaker; ``commands``: the command line.
"""

import lazy_loader

from granular.shared.errors import with_missing_package_advice

# The names in __init__.pyi are imported on first use, so importing the package takes almost no time.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = with_missing_package_advice(__getattr__)
