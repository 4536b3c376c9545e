from .page import plot_design, plot_maps
from .proposal import Wish, propose

__all__ = [
    "Wish", "plot_design", "plot_maps", "propose",
]  # fmt: skip
