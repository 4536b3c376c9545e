from .catalogue import LAWS as LAWS
from .catalogue import law_named as law_named
from .law import Law as Law
