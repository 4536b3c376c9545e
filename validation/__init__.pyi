from .choice import cheapest
from .convergence_result import ConvergenceResult, convergence_table
from .cost import Setting, WorkPrecision, work_precision
from .exact import exact_problem, exact_problems
from .hard_cases import catalogue, energy_change, head_on, near_limit
from .order import convergence
from .outcomes import outcome
from .own_method import method_report
from .trend import Trend, energy_trend

__all__ = [
    "ConvergenceResult", "Setting", "Trend", "WorkPrecision", "catalogue", "cheapest",
    "convergence", "convergence_table", "energy_change", "energy_trend", "exact_problem",
    "exact_problems", "head_on", "method_report", "near_limit", "outcome", "work_precision",
]  # fmt: skip
