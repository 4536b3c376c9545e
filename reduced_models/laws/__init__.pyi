from .catalogue import LAWS, law_named
from .force_laws import FORCE_LAWS
from .law import Law

__all__ = ["FORCE_LAWS", "LAWS", "Law", "law_named"]
