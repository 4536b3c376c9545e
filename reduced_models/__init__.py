"""From a piston's motion to its equation.

>>> from reduced_models import PistonRecord, fit
>>> model = fit(PistonRecord.from_csv("lab.csv"), law="van-der-pol-like")
>>> print(model)
"""

import lazy_loader

from granular.shared.errors import with_advice

# Names, which stand in __init__.pyi, are imported when they are used: importing the package costs
# next to nothing.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = with_advice(__getattr__)
