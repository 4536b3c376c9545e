"""From a piston's motion to its equation.

>>> from reduced_models import PistonRecord, fit
>>> model = fit(PistonRecord.from_csv("lab.csv"), law="van-der-pol-like")
>>> print(model)

Each folder uses only the folders before it. ``records`` holds motions of a piston and their analysis
without a law; ``laws`` holds equations of motion and their solutions. ``models`` predict motions and are
written to files; ``fitting`` makes a model from a record and a law, ``derived`` from a bed's equilibria
and roots. The next folders build on these. ``falls`` compares a law with records of other falls;
``discovery`` finds a law; ``calibration`` fits a scene's parameters; ``designs`` designs a damper;
``machines`` couples a damper to a machine; ``identification`` leads from a source to a report.
``commands`` calls all of these, and ``jax_setup`` imports JAX.
"""

import lazy_loader

from granular.shared.errors import with_missing_package_advice

# Names are listed in __init__.pyi and imported on first use, so importing the package takes almost no time.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = with_missing_package_advice(__getattr__)
