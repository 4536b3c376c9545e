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
    """

    value: float
    spread: float | None = None
    starts: int = 0
    protocol: str = "exact"
    step: str = ""
