"""The source's own test of its method [D, 2.3.4], in full, and what of it is rounding.

One grain of 5 mm falls from 40 D and bounces on the wall for 2 s, with seven steps from 1e-6 to
1e-8 s. The source integrates in the position form, y_{n+1} = 2 y_n - y_{n-1} + h^2 a(y_n), judges
the error at the end against its finest step, and prints a greatest difference of two peaks of
6.8e-9 m. In the position form h^2 a is added to a number 1e10 times as large, so most of its digits
are lost. The same sequence in increments, d_n = d_{n-1} + h^2 a(y_n), y_{n+1} = y_n + d_n, both
sums compensated (Kahan 1965, doi:10.1145/363707.363723), has the truncation without the rounding;
what the two differ by is rounding. The toolkit's own compensated sums are run beside them.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from granular.effects.wall_experimental import force
from granular.scales import Scales
from validation.exact import bounce
from validation.table import Table, table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STEPS = (1e-6, 5e-7, 2e-7, 1e-7, 5e-8, 2e-8, 1e-8)
PLAIN, COMPENSATED, TOOLKIT = "position form", "compensated increments", "toolkit, compensated"
PRINTED_PEAKS = 6.8e-9
"""Greatest difference of two peaks as the source prints it [m]."""

_PEAKS = 16


@numba.njit
def _position_form(
    start: float, weight: float, h: float, steps: int, peaks: np.ndarray
) -> tuple[float, int]:
    """The end, and how many peaks were found, by the position form from rest."""
    square = h * h
    before = start
    now = start + 0.5 * square * (force(start) - weight)
    found = 0
    for _ in range(steps - 1):
        later = 2.0 * now - before + square * (force(now) - weight)
        if now >= before and now > later and found < peaks.size:
            peaks[found] = now
            found += 1
        before, now = now, later
    return now, found


@numba.njit
def _compensated_form(
    start: float, weight: float, h: float, steps: int, peaks: np.ndarray
) -> tuple[float, int]:
    """The same sequence in compensated increments."""
    square = h * h
    gain = 0.5 * square * (force(start) - weight)
    now, lost = start, 0.0
    gain_lost = 0.0
    found = 0
    rising = False
    for step in range(steps):
        if step > 0:
            add = square * (force(now) - weight) - gain_lost
            total = gain + add
            gain_lost = (total - gain) - add
            gain = total
        if rising and gain < 0.0 and found < peaks.size:
            # What is lost of a sum in compensation is part of its value.
            peaks[found] = now
            found += 1
        rising = gain > 0.0
        add = (gain - gain_lost) - lost
        total = now + add
        lost = (total - now) - add
        now = total
    return now, found


@dataclasses.dataclass(frozen=True)
class SourceRun:
    """One form at one step.

    Attributes
    ----------
    form : str
    step : float
        [s]
    end, error : float
        Height after 2 s, and its error against the exact one [m].
    peaks : float or None
        Greatest difference of two peaks, the start included [m].
    seconds : float
        Wall time.
    """

    form: str
    step: float
    end: float
    error: float
    peaks: float | None
    seconds: float


@dataclasses.dataclass(frozen=True)
class SourceExperiment:
    """All forms at all steps."""

    runs: tuple[SourceRun, ...]

    def of(self, form: str) -> tuple[SourceRun, ...]:
        """The runs of one form, from coarse to fine."""
        return tuple(one for one in self.runs if one.form == form)

    def slope(self, form: str, finest: float = 5e-8) -> float:
        """Slope of the error against the exact height, from the coarsest step to a finest one."""
        runs = [one for one in self.of(form) if one.step >= 0.999 * finest]
        return _slope([one.step for one in runs], [one.error for one in runs])

    def slope_to_finest(self, form: str) -> float:
        """Slope of the error against the finest step's height: the source's figure."""
        *runs, last = self.of(form)
        return _slope([one.step for one in runs], [abs(one.end - last.end) for one in runs])

    def rounding(self) -> dict[float, float]:
        """What rounding does to the position form at each step [m]."""
        clean = {one.step: one.end for one in self.of(COMPENSATED)}
        return {one.step: abs(one.end - clean[one.step]) for one in self.of(PLAIN)}

    def agreement(self) -> float:
        """Greatest difference of the position form and the velocity form, both compensated [m].

        They are the same sequence of positions: y_{n+1} - 2 y_n + y_{n-1} = h^2 a(y_n) follows
        from two steps of the velocity form (Hairer, Lubich and Wanner 2003, section 1).
        """
        ends = {one.step: one.end for one in self.of(COMPENSATED)}
        return max(abs(one.end - ends[one.step]) for one in self.of(TOOLKIT))

    def table(self) -> Table:
        """One row a run."""
        rounding = self.rounding()
        rows = [
            (
                one.form, f"{one.step:g}", f"{one.error:.2e}",
                f"{rounding[one.step]:.1e}" if one.form == PLAIN else "",
                "" if one.peaks is None else f"{one.peaks:.1e}", f"{one.seconds:.2g}",
            )
            for one in self.runs
        ]  # fmt: skip
        header = (
            "form", "step [s]", "error [m]", "rounding [m]", "peak difference [m]", "seconds"
        )  # fmt: skip
        return table(header, rows)

    def plot(self, axes: Axes) -> None:
        """Draw the errors of each form over the step."""
        for form in dict.fromkeys(one.form for one in self.runs):
            runs = self.of(form)
            axes.loglog([one.step for one in runs], [one.error for one in runs], marker="o",
                        markersize=3.5, label=form)  # fmt: skip
        axes.set_xlabel("time step [s]")
        axes.set_ylabel("error after 2 s [m]")
        axes.legend()

    def to_dict(self) -> dict[str, Any]:
        """The experiment as plain data."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> SourceExperiment:
        """The experiment from what `to_dict` made, also by way of JSON."""
        return cls(tuple(SourceRun(**one) for one in plain["runs"]))


def _slope(steps: list[float], errors: list[float]) -> float:
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def source_experiment(*, full: bool = True) -> SourceExperiment:
    """Carry out the experiment.

    Parameters
    ----------
    full : bool
        All seven steps, and the toolkit up to 5e-8 s; without, steps down to 1e-7 s.
    """
    steps = STEPS if full else STEPS[:4]
    problem = bounce.problem()
    exact = float(problem.exact(bounce.TIME).positions[0, 1])
    runs = [_form(form, step, exact) for form in (PLAIN, COMPENSATED) for step in steps]
    runs += [_toolkit(step, exact) for step in (steps[:5] if full else steps[:2])]
    return SourceExperiment(tuple(runs))


def _form(form: str, step: float, exact: float) -> SourceRun:
    scene = bounce.problem().scene
    scales = Scales.of(scene.grains)
    assert scene.effects.gravity is not None
    weight = scene.effects.gravity.acceleration / scales.acceleration
    loop = _position_form if form == PLAIN else _compensated_form
    peaks = np.zeros(_PEAKS)
    h, count = step / scales.time, round(bounce.TIME / step)
    loop(float(bounce.START), weight, h, 2, peaks)  # compiles
    begun = time.perf_counter()
    end, found = loop(float(bounce.START), weight, h, count, peaks)
    seconds = time.perf_counter() - begun
    heights = np.append(peaks[:found], float(bounce.START)) * scales.length
    end *= scales.length
    return SourceRun(form, step, end, abs(end - exact), float(np.ptp(heights)), seconds)


def _toolkit(step: float, exact: float) -> SourceRun:
    from granular.simulation import simulate

    begun = time.perf_counter()
    run = simulate(
        bounce.problem().scene, dt=step, t_end=bounce.TIME, method="stormer-verlet+compensated",
        progress=False,
    )  # fmt: skip
    end = float(run.dataset["position"].values[-1, 0, 1])
    seconds = time.perf_counter() - begun
    return SourceRun(TOOLKIT, step, end, abs(end - exact), None, seconds)
