"""Whole falls: laws fitted to one fall of a piston, judged on falls that no fit has seen.

>>> from reduced_models import judged_falls, predict
>>> law = predict(scene)  # from the scene alone
>>> falls = judged_falls(fall, unseen, scene=scene)  # from one fall
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
