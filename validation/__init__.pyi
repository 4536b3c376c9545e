from .accuracy_cost import work_precision
from .convergence_order import convergence
from .convergence_result import convergence_table
from .energy_drift import energy_trend
from .exact_problems import exact_problem
from .hard_case import energy_change, head_on_collision, scene_near_stability_limit
from .hard_case_outcomes import run_hard_case
from .hard_cases import hard_case_catalogue
from .recommendation import recommend_settings
from .report import method_report
from .work_precision_result import SolverSettings

__all__ = [
    "SolverSettings",
    "convergence",
    "convergence_table",
    "energy_change",
    "energy_trend",
    "exact_problem",
    "hard_case_catalogue",
    "head_on_collision",
    "method_report",
    "recommend_settings",
    "run_hard_case",
    "scene_near_stability_limit",
    "work_precision",
]
