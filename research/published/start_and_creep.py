"""Beds with both causes of de Paula's hysteresis: the height of the first grid, and creep.

Under the regularised law the velocity of a grain changes within a step by far more than the law's
threshold, so that a grain at rest chatters about zero and drifts along the force on it: by about
a dt in velocity for an acceleration a. The distance it creeps grows with the step and with time.
A cycle that is four times faster, at a step that is four times longer, creeps as far and takes a
sixteenth of the steps; `ACCELERATED` is that cycle.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from research.published.protocols import ACCELERATED, HASTE, PUBLISHED, QUICK, Protocol
from research.published.series import Series, mono
from validation.measured_quantities import compression_duration

GRID = 1.15
"""Height of the first grid, over the piston's height at the compression's start: the one number
that is fitted, to the start of `FITTED_SIZE` grains alone under de Paula's friction, to a
twentieth. De Paula does not print it."""
CREEP_GRID = 1.1
"""The same where step and threshold are changed: the exact law's fit."""
FITTED_SIZE = 736
"""The largest size of [D, Table 3.1], where the height moves the start by most deviations."""
STEPS = (0.5, 1.0, 2.0, 4.0)
"""Steps, over the accelerated cycle's own."""
DIAMETER = 0.006


def regularised(period: float, diameter: float = DIAMETER, *, threshold: float = 1.0) -> dict[str, Any]:
    """De Paula's friction, with its threshold of 1e-6 D/T times ``threshold``."""
    return {"scheme": "regularised", "threshold": threshold * 1e-6 * diameter / period}


def grid_of_height(count: int, height: float) -> dict[str, Any]:
    """Grains that stand farther apart at first, under a piston that starts higher."""
    start = mono("", count, QUICK).scene(1).arrangement.height
    assert start is not None
    return {"arrangement__height": height * start, "piston__height": 1.1 * height * start}


def both_causes(
    count: int,
    protocol: Protocol = ACCELERATED,
    *,
    seeds: Sequence[int] = (1, 2, 3),
    step: float = 1.0,
    threshold: float = 1.0,
    grid: float = GRID,
    words: str = "both causes",
) -> Series:
    """A bed with de Paula's friction at its step and the fitted height of the first grid.

    ``step`` and ``threshold`` are multiples of de Paula's; the step is longer by `HASTE` in the
    accelerated cycle.
    """
    period = compression_duration(count, PUBLISHED.speed)
    haste = HASTE if protocol is ACCELERATED else 1.0
    return mono(
        f"direct {count}, {words}",
        count,
        protocol,
        seeds=seeds,
        step=step * haste * 1e-6 * period,
        effects__friction=regularised(period, threshold=threshold),
        **grid_of_height(count, grid),
    )


def both_at(sizes: Sequence[int], protocol: Protocol, seeds: Sequence[int]) -> list[Series]:
    """Both causes at several sizes."""
    return [both_causes(count, protocol, seeds=seeds) for count in sizes]


def creep(count: int, seeds: Sequence[int] = (1, 2)) -> list[Series]:
    """Several steps, and a threshold of ten times de Paula's, through the accelerated cycle."""
    wide = both_causes(count, threshold=10.0, seeds=seeds, grid=CREEP_GRID, words="threshold ten times")
    return [
        *(
            both_causes(count, step=step, seeds=seeds, grid=CREEP_GRID, words=creep_name(step))
            for step in STEPS
        ),
        wide,
    ]


def creep_name(step: float) -> str:
    """End of the name of a series by its step."""
    return f"{step:g} times the step"
