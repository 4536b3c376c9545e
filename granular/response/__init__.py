"""Response of a machine (the host of a damper) to what shakes it."""

from granular.response.response import frequency_response, load_response, save_response
from granular.response.steady import swept_response
from granular.response.transients import run_frequency_sweep, run_impulse, settling_time

__all__ = [
    "frequency_response",
    "load_response",
    "run_frequency_sweep",
    "run_impulse",
    "save_response",
    "settling_time",
    "swept_response",
]
