"""How far a bed is from rest, as seen while it settles."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from granular.kernel_data.state import HEIGHT, SPEED
from granular.protocol.stage import Timed
from granular.run.watch import rest_limit

if TYPE_CHECKING:
    from granular.run.run import Run


class Settling:
    """What still moves, over the last window of rest, beside what counts as rest.

    Attributes
    ----------
    amplitude : float
        Range of the piston's heights [D], or the greatest speed [D/tau] where that is more.
    limit : float
        Of the amplitude, at rest.
    share : float
        How much of the way to the limit is done, in orders of magnitude: 0 to 1.
    """

    def __init__(self, run: Run) -> None:
        stage = run.stage
        assert isinstance(stage, Timed)
        self.limit = rest_limit(run)
        self.amplitude, self.share = math.inf, 0.0
        self._window = stage.window / run.system.scales.time
        self._seen: deque[tuple[float, float, float]] = deque()
        self._greatest = 0.0

    def look(self, run: Run) -> None:
        """Take in the present state."""
        state = run.state
        fastest = float(np.hypot(state.vx, state.vy).max(initial=abs(float(state.piston[SPEED]))))
        self._seen.append((run.time, float(state.piston[HEIGHT]), fastest))
        while self._seen[0][0] < run.time - self._window:
            self._seen.popleft()
        heights = [height for _, height, _ in self._seen]
        swing = max(heights) - min(heights)
        self.amplitude = max(swing, *(speed for _, _, speed in self._seen), 0.0)
        self._greatest = max(self._greatest, self.amplitude)
        if self.amplitude <= self.limit:
            self.share = 1.0
        elif self._greatest > self.limit:
            way = math.log(self._greatest / self.limit)
            self.share = math.log(self._greatest / self.amplitude) / way

    def __str__(self) -> str:
        return f"moves {self.amplitude:.1e} D, at rest below {self.limit:.0e} D"
