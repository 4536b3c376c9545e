"""From a piston's motion to its equation.

>>> from reduced_models import PistonRecord, fit
>>> model = fit(PistonRecord.from_csv("lab.csv"), law="van-der-pol-like")
>>> print(model)

Each folder knows those before it. ``records`` are motions of a piston and what they say without a
law; ``laws`` are its equations with their solutions. ``models`` predict, and are written to files;
``fitting`` makes one of a record and a law, ``derived`` one of a bed's equilibria and roots. On these
stand ``falls`` (a law against records of other falls) and the jobs: ``discovery`` finds a law,
``calibration`` the parameters of a scene, ``designs`` a damper, and ``machines`` its use in a machine;
``identification`` goes from a source to a report.
``commands`` call all these, and ``jax_setup`` is where JAX is imported.
"""

import lazy_loader

from granular.shared.errors import with_missing_package_advice

# Names, which stand in __init__.pyi, are imported when they are used: importing the package costs
# next to nothing.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = with_missing_package_advice(__getattr__)
