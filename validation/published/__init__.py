"""De Paula's published values beside the toolkit's own, with scatter and a verdict each.

>>> from validation.published import published
>>> found = published("out/published", "quick")
"""

import lazy_loader

# Names, which stand in __init__.pyi, are imported when they are used: importing the package costs
# next to nothing.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
