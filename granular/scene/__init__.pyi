from .arrangement import Arrangement
from .loading import load_scene, scene_names
from .parts import Cell, Grains, Output, Piston, Species
from .scales import Scales
from .scene import Effects, Scene
from .schema import Section, quantity
from .units import si_value, unit_size

__all__ = [
    "Arrangement", "Cell", "Effects", "Grains", "Output", "Piston", "Scales", "Scene",
    "Section", "Species", "load_scene", "quantity", "scene_names", "si_value", "unit_size",
]  # fmt: skip
