from .convergence_order import convergence
from .convergence_result import convergence_table
from .cost import SolverSettings, work_precision
from .custom_method import method_report
from .exact import exact_problem
from .hard_case_outcomes import run_hard_case
from .hard_cases import energy_change, hard_case_catalogue, head_on_collision, scene_near_stability_limit
from .recommendation import recommend_settings
from .trend_significance import energy_trend

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
