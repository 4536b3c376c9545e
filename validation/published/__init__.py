"""Numbers that de Paula (2025) prints.

>>> from validation.published import published_value
>>> alpha = published_value("damper.van_der_pol_like.alpha")
"""

import lazy_loader

# Names, which stand in __init__.pyi, are imported when they are used: importing the package costs
# next to nothing.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
