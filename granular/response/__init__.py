"""What is left of a machine's vibration: a host's response to what shakes it, with its damper."""

from granular.response.come_down import come_down_time
from granular.response.kept import load_response, save_response
from granular.response.response import Response, frequency_response
from granular.response.swept import swept_response
from granular.response.transients import Impulse, run_impulse, run_sweep

__all__ = [
    "Impulse",
    "Response",
    "come_down_time",
    "frequency_response",
    "load_response",
    "run_impulse",
    "run_sweep",
    "save_response",
    "swept_response",
]
