"""What is left of a machine's vibration: a host's response to what shakes it, with its damper."""

from granular.response.come_down import come_down_time
from granular.response.response import Response, frequency_response
from granular.response.swept import swept_response

__all__ = ["Response", "come_down_time", "frequency_response", "swept_response"]
