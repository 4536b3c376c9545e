"""What is left of a machine's vibration: a host's response to what shakes it, with its damper."""

from granular.response.response import Response, frequency_response

__all__ = ["Response", "frequency_response"]
