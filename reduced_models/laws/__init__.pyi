from .catalogue import LAWS, law_named
from .force_law import FORCE_LAWS, ForceLaw
from .law import Law

__all__ = ["FORCE_LAWS", "LAWS", "ForceLaw", "Law", "law_named"]
