from .convergence_order import convergence
from .convergence_result import convergence_table
from .cost import SolverSettings, work_precision
from .custom_method import method_report
from .exact import exact_problem
from .hard_case_outcomes import outcome
from .hard_cases import catalogue, energy_change, head_on_collision, near_stability_limit
from .recommendation import recommend_settings
from .trend_significance import energy_trend

__all__ = [
    "SolverSettings",
    "catalogue",
    "convergence",
    "convergence_table",
    "energy_change",
    "energy_trend",
    "exact_problem",
    "head_on_collision",
    "method_report",
    "near_stability_limit",
    "outcome",
    "recommend_settings",
    "work_precision",
]
