from .page import plot_design as plot_design
from .page import plot_maps as plot_maps
from .proposal import Wish as Wish
from .proposal import propose as propose
