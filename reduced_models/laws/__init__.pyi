from .catalogue import LAWS, law_named
from .law import Law

__all__ = ["LAWS", "Law", "law_named"]
