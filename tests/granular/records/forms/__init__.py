"""One motion as many instruments and programs write it: bytes, as they come from them."""

from . import texts, formats, instruments  # isort: skip - they note their forms, in this order
from .form import FORCE, FORMS, HEIGHT, TIME
from .objects import in_memory
from .refused import REFUSED

__all__ = ["FORCE", "FORMS", "HEIGHT", "REFUSED", "TIME", "formats", "in_memory", "instruments", "texts"]
