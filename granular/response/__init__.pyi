from .response import frequency_response, load_response, save_response, swept_response
from .transients import run_frequency_sweep, run_impulse, settling_time

__all__ = [
    "frequency_response",
    "load_response",
    "run_frequency_sweep",
    "run_impulse",
    "save_response",
    "settling_time",
    "swept_response",
]
