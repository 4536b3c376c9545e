"""What the toolkit finds for a published number."""

from __future__ import annotations

from typing import NamedTuple


class Finding(NamedTuple):
    """What the toolkit finds.

    Attributes
    ----------
    value : float
        The mean over the starts.
    spread : float or None
        Standard deviation of single starts; None for one start.
    starts : int
        0 where nothing is random.
    protocol : str
    step : str
    error : float or None
        Standard error of the value; None where it is not known.
    freedom : float
        Degrees of freedom of that error.
    """

    value: float
    spread: float | None = None
    starts: int = 0
    protocol: str = "exact"
    step: str = ""
    error: float | None = None
    freedom: float = 0.0

    def half_width(self, confidence: float = 0.95) -> float | None:
        """Half the width of Student's interval of the value."""
        from scipy.special import stdtrit

        if self.error is None or self.freedom <= 0.0:
            return None
        return float(stdtrit(self.freedom, 0.5 + 0.5 * confidence)) * self.error
