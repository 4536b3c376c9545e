from .choice import cheapest as cheapest
from .cost import WorkPrecision as WorkPrecision
from .cost import work_precision as work_precision
from .exact import exact_problems as exact_problems
from .order import ConvergenceResult as ConvergenceResult
from .order import convergence as convergence
from .trend import Trend as Trend
from .trend import energy_trend as energy_trend
