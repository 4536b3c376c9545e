"""Error against wall time: what accuracy costs, and which setting to take.

Each setting is run from the same few starts. Its error is the mean of the deviations from a
reference at the same starts, with a standard error next to it; how far the starts themselves
scatter is the floor, below which a shorter step buys nothing and more starts do. A setting that
fails stays in the picture as a failure. Positions may also be computed by outside references
(`validation.external_integrators`); these are shown and never chosen.
"""

from validation.cost.advised_setting import SolverSettings
from validation.cost.work_precision import work_precision
from validation.cost.work_precision_result import WorkPrecision

__all__ = ["SolverSettings", "WorkPrecision", "work_precision"]
