"""Value that the toolkit gives for a published number."""

from __future__ import annotations

from typing import NamedTuple


class Finding(NamedTuple):
    """The toolkit's value, with its scatter and error.

    Attributes
    ----------
    value : float
        Mean over the starts.
    spread : float or None
        Standard deviation of single starts; None for one start.
    starts : int
        Number of starts; 0 if nothing is random.
    protocol : str
    step : str
    error : float or None
        Standard error of the value; None if unknown.
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
        """Return half the width of Student's interval of the value."""
        from scipy.special import stdtrit

        if self.error is None or self.freedom <= 0.0:
            return None
        return float(stdtrit(self.freedom, 0.5 + 0.5 * confidence)) * self.error
