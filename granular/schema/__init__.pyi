from .natural_units import Scales
from .sections import Section
from .units import si_value, unit_size

__all__ = ["Scales", "Section", "si_value", "unit_size"]
