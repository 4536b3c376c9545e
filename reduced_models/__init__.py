"""From a piston's motion to its equation.

>>> from reduced_models import PistonRecord, fit
>>> model = fit(PistonRecord.from_csv("lab.csv"), law="van-der-pol-like")
>>> print(model)

The folders, each of which uses only the folders listed before it:

- ``records``: motions of a piston, and their analysis without a law
- ``laws``: equations of motion and their solutions
- ``models``: laws with parameter values, which predict motions and are written to files
- ``fitting``: models from a record and a law
- ``derived``: models from a bed's equilibria and complex roots
- ``falls``: comparison of a law with records of other falls
- ``discovery``: search for a law
- ``calibration``: fit of a scene's parameters to a record
- ``designs``: design of a damper
- ``machines``: a damper coupled to a machine
- ``identification``: from a file or scene to a report
- ``commands``: command lines of all these

The module ``jax_setup`` imports JAX.
"""

import lazy_loader

from granular.shared.errors import with_missing_package_advice

# Names are listed in __init__.pyi and imported on first use, so importing the package takes almost no time.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = with_missing_package_advice(__getattr__)
