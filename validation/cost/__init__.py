"""Error against wall time: what accuracy costs, and which setting to take.

Each setting is run from the same few starts. Its error is the mean of the deviations from a
reference at the same starts, with a standard error beside it; how far the starts themselves
scatter is the floor, below which a shorter step buys nothing and more starts do. A setting that
fails stays in the picture as a failure. Positions may also be computed by outside references
(`validation.outside`); these are shown and never chosen.
"""

from validation.cost.advice import FLOORS, Advice
from validation.cost.measuring import (
    Reference,
    finest,
    varies,
    work_precision,
    work_precisions,
)
from validation.cost.point import USUAL, Point, Setting
from validation.cost.study import LEVELS, WorkPrecision

__all__ = [
    "FLOORS", "LEVELS", "USUAL", "Advice", "Point", "Reference", "Setting", "WorkPrecision",
    "finest", "varies", "work_precision", "work_precisions",
]  # fmt: skip
