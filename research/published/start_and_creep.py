"""Beds with both causes of de Paula's hysteresis: the height of the initial grid, and creep.

With regularised friction the velocity of a grain changes in one step by far more than the threshold speed of
the friction law. The velocity of a grain that should rest therefore alternates in sign, and the grain creeps
along the force on it, with a velocity of about a dt for an acceleration a. The creep distance is proportional
to step and time. A cycle that is four times faster, with a step that is four times longer, gives the same
creep with a sixteenth of the steps (`ACCELERATED`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from research.published.protocols import ACCELERATED, HASTE, PUBLISHED, QUICK, CompressionProtocol
from research.published.series import Series, equal_grain_series
from validation.measured_quantities import compression_duration

GRID = 1.15
"""Height of the first grid, over the piston's height at the compression's start: the only fitted number,
adjusted in steps of 1/20 to the start of `FITTED_SIZE` grains under de Paula's friction. De Paula does not
print it."""
CREEP_GRID = 1.1
"""The same for changed step and threshold: fitted with the exact law."""
FITTED_SIZE = 736
"""The largest size of [D, Table 3.1], at which the height changes the start by the most deviations."""
STEPS = (0.5, 1.0, 2.0, 4.0)
"""Steps, over the step of the accelerated cycle."""
DIAMETER = 0.006


def regularised_friction_settings(
    period: float, diameter: float = DIAMETER, *, threshold: float = 1.0
) -> dict[str, Any]:
    """Return de Paula's friction, with its threshold of 1e-6 D/T times ``threshold``."""
    return {"scheme": "regularised", "threshold": threshold * 1e-6 * diameter / period}


def grid_height_changes(count: int, height: float) -> dict[str, Any]:
    """Return a first grid with larger distances, under a piston that starts higher."""
    start = equal_grain_series("", count, QUICK).scene(1).arrangement.height
    assert start is not None
    return {"arrangement__height": height * start, "piston__height": 1.1 * height * start}


def series_with_both_causes(
    count: int,
    protocol: CompressionProtocol = ACCELERATED,
    *,
    seeds: Sequence[int] = (1, 2, 3),
    step: float = 1.0,
    threshold: float = 1.0,
    grid: float = GRID,
    words: str = "both causes",
) -> Series:
    """Return a bed with de Paula's friction at its step and the fitted height of the first grid.

    ``step`` and ``threshold`` are multiples of de Paula's; the step is longer by `HASTE` in the
    accelerated cycle.
    """
    period = compression_duration(count, PUBLISHED.speed)
    haste = HASTE if protocol is ACCELERATED else 1.0
    return equal_grain_series(
        f"direct {count}, {words}",
        count,
        protocol,
        seeds=seeds,
        step=step * haste * 1e-6 * period,
        effects__friction=regularised_friction_settings(period, threshold=threshold),
        **grid_height_changes(count, grid),
    )


def series_with_both_causes_by_size(
    sizes: Sequence[int], protocol: CompressionProtocol, seeds: Sequence[int]
) -> list[Series]:
    """Return beds with both causes at several sizes."""
    return [series_with_both_causes(count, protocol, seeds=seeds) for count in sizes]


def creep_series(count: int, seeds: Sequence[int] = (1, 2)) -> list[Series]:
    """Return runs with several steps, and with ten times the threshold, for the accelerated cycle."""
    wide = series_with_both_causes(
        count, threshold=10.0, seeds=seeds, grid=CREEP_GRID, words="threshold ten times"
    )
    return [
        *(
            series_with_both_causes(
                count, step=step, seeds=seeds, grid=CREEP_GRID, words=creep_name_suffix(step)
            )
            for step in STEPS
        ),
        wide,
    ]


def creep_name_suffix(step: float) -> str:
    """Return the end of a series' name for its step."""
    return f"{step:g} times the step"
