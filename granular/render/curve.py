"""The piston's height over time, below the bed in a movie."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.render.page import INK
from granular.run.trajectory import Trajectory
from granular.shared.plotting import COLOURS, GREY

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST = 4000
"""Points of the curve: more than there are pixels."""


class PistonCurve:
    """The curve of the whole movie, and what of it has been so far."""

    def __init__(self, run: Trajectory, start: float, end: float, axes: Axes) -> None:
        data = run.dataset
        time = data["time"].values
        chosen = np.flatnonzero((time >= start) & (time <= end))
        chosen = chosen[:: max(1, len(chosen) // MOST)]
        self._time = time[chosen]
        self._height = 1e3 * data["piston_height"].values[chosen]
        axes.plot(self._time, self._height, color=GREY, linewidth=0.8)
        (self._past,) = axes.plot([], [], color=COLOURS[0], linewidth=1.6)
        (self._now,) = axes.plot([], [], "o", color=COLOURS[1], markersize=4.5)
        axes.set_xlim(start, end if end > start else start + 1.0)
        axes.set(xlabel="time [s]", ylabel="piston [mm]")
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(length=2.5, width=0.6, color=INK)

    def show(self, time: float) -> None:
        """Bring it up to date."""
        past = self._time <= time
        self._past.set_data(self._time[past], self._height[past])
        if past.any():
            self._now.set_data(self._time[past][-1:], self._height[past][-1:])
