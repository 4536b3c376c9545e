"""The distances of [D, Table 3.1] with both causes of the hysteresis, and how far grains creep."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from research.published.entry import PLAIN, verdict
from research.published.finding import Finding
from research.published.measures import mean_of, pooled_deviation
from research.published.plan import SIZES
from research.published.protocols import ACCELERATED, HASTE
from research.published.results import Results
from research.published.start_and_creep import FITTED_SIZE, GRID, STEPS, creep_name
from research.published.velocity_variants import LATE_HASTE, LATE_SEEDS
from validation.measured_quantities import published_value

COLUMNS = (
    ("start", "half_start_D", "half_mean_distance.start"),
    ("end", "half_end_D", "half_mean_distance.end"),
    ("hysteresis", "hysteresis_D", "hysteresis_of_distance.hysteresis"),
)
CREEP_SIZE = 368
"""Grains of the bed whose step and threshold were changed."""


class WithBoth(NamedTuple):
    """A distance of Table 3.1 without and with both causes [D].

    Attributes
    ----------
    grains : int
    what : str
        ``"start"``, ``"end"`` or ``"hysteresis"``.
    published : float
    usual, both : Finding
        By the exact law from the usual grid, and with both causes.
    late : Finding or None
        With both causes and the velocity of [D, eq. 2.17] one step late, by an independent loop;
        None where that was not run.
    allowed, late_allowed : float
        Half of the prediction intervals with both, by the scatter of all sizes together.
    usual_within, within, late_within : bool
        Whether the published number lies in the prediction interval.
    """

    grains: int
    what: str
    published: float
    usual: Finding
    both: Finding
    late: Finding | None
    allowed: float
    late_allowed: float
    usual_within: bool
    within: bool
    late_within: bool


def with_both_causes(results: Results) -> list[WithBoth]:
    """Every distance whose runs are there, column by column."""
    rows = []
    beds = [f"direct {n}" for n in SIZES]
    changed = [f"{name}, both causes" for name in beds]
    for what, figure, key in COLUMNS:
        for k, count in enumerate(SIZES):
            usual = mean_of(beds[k], figure, pool=beds)(results)
            both = mean_of(changed[k], figure, pool=changed, protocol=ACCELERATED.name)(results)
            late = _late(results, what, count, figure, changed)
            if usual is None or both is None:
                continue
            published = float(published_value(f"{key}[{k}]"))
            verdicts = [verdict(published, None, finding, PLAIN, 2) for finding in (usual, both, late)]
            allowed = [judged.allowed or 0.0 for judged in verdicts]
            within = [judged.agrees is True for judged in verdicts]
            rows.append(
                WithBoth(
                    count,
                    what,
                    published,
                    usual,
                    both,
                    late,
                    allowed[1],
                    allowed[2],
                    within[0],
                    within[1],
                    within[2],
                )
            )
    return rows


def _late(results: Results, what: str, count: int, figure: str, beds: Sequence[str]) -> Finding | None:
    """The independent loop's, with the scatter of the beds with both causes."""
    names = [f"{count}, {seed}" for seed in LATE_SEEDS]
    ends = {
        when: [results.number("late_velocity", f"{when} {name}") for name in names]
        for when in ("start", "end")
    }
    pooled = pooled_deviation(results, beds, figure, ACCELERATED.name)
    if pooled is None or None in ends["start"] + ends["end"]:
        return None
    start, end = (np.array(ends[when], dtype=float) for when in ("start", "end"))
    values = {"start": start, "end": end, "hysteresis": start - end}[what]
    spread, freedom = pooled
    error = spread / len(values) ** 0.5
    return Finding(float(values.mean()), spread, len(values), "late", error=error, freedom=float(freedom))


def summary_of_both(rows: Sequence[WithBoth]) -> dict[str, int]:
    """How many distances lie in their prediction intervals, without and with both causes."""
    return {
        "distances": len(rows),
        "within by the exact law": sum(row.usual_within for row in rows),
        "within with both causes": sum(row.within for row in rows),
        "run with equation 2.17 late": sum(row.late is not None for row in rows),
        "within with equation 2.17 late": sum(row.late_within for row in rows),
    }


def words_on_both(results: Results) -> str:
    """The causes, the count, and every distance that is missed, in a few sentences."""
    rows = with_both_causes(results)
    if not rows:
        return "Both causes of the hysteresis together: not run."
    number = summary_of_both(rows)
    missed = "; ".join(
        f"{row.what} at {row.grains} ({row.both.value:.2f} for {row.published:.2f} D)"
        for row in rows
        if not row.within
    )
    tail = f" Missed: {missed}." if missed else ""
    return (
        "The hysteresis of the mean distance has two causes that add. At the end of the cycle the "
        "bed is wider, for with de Paula's regularised friction at its step grains chatter about "
        "rest and creep; at its start it is narrower, for the first grid, whose height the thesis "
        f"does not print, is higher. With both, the grid {GRID:g} times as high as the piston's "
        f"first height, which was fitted to the start of {FITTED_SIZE} grains alone, "
        f"{number['within with both causes']} of {number['distances']} published starts, ends and "
        "hystereses lie in their prediction intervals, by the scatter of all sizes together; by "
        f"the exact law from the usual grid {number['within by the exact law']} do.{tail}"
        f"{_words_on_velocity(rows)}"
    )


def _words_on_velocity(rows: Sequence[WithBoth]) -> str:
    """How the velocity that friction is given moves the distances."""
    late = [row for row in rows if row.late is not None]
    if not late:
        return ""
    ends = ", ".join(
        f"{row.late.value:.2f} D ({row.published:.2f}) at {row.grains}"
        for row in late
        if row.what == "end" and row.late is not None
    )
    missed = "; ".join(
        f"{row.what} at {row.grains} ({row.late.value:.2f} for {row.published:.2f} D)"
        for row in late
        if row.late is not None and not row.late_within
    )
    return (
        " How fast chattering grains creep depends on the velocity that friction is given. With "
        "equation 2.17 of the step before, which is all that a loop has when it needs the "
        f"friction, the ends are, published in brackets, {ends}; by this independent loop, one "
        f"start each, through a cycle {LATE_HASTE:g} times faster at a step {LATE_HASTE:g} times "
        f"longer, {sum(row.late_within for row in late)} of {len(late)} distances lie in their "
        "intervals" + (f", all but {missed}." if missed else ".")
    )


class Creep(NamedTuple):
    """Half the mean distance at the end [D] over the step [1e-6 T]."""

    step: float
    end: Finding


def creep_over_step(results: Results) -> list[Creep]:
    """Of `CREEP_SIZE` grains, from the exact law (step 0) on."""
    usual = mean_of(f"direct {CREEP_SIZE}", "half_end_D")(results)
    names = [f"direct {CREEP_SIZE}, {creep_name(step)}" for step in STEPS]
    creeping = [mean_of(name, "half_end_D", pool=names, protocol=ACCELERATED.name)(results) for name in names]
    ends = zip((0.0, *STEPS), (usual, *creeping), strict=True)
    return [Creep(x, end) for x, end in ends if end is not None]


def words_on_creep(results: Results) -> str:
    """How creep grows with step, time and threshold."""
    points = creep_over_step(results)
    name = f"direct {CREEP_SIZE}, threshold ten times"
    wide = mean_of(name, "half_end_D", protocol=ACCELERATED.name)(results)
    if len(points) < 2 or wide is None:
        return "How creep grows with the step: not run."
    listed = ", ".join(
        f"{point.end.value - points[0].end.value:.2f} D at {point.step:g}" for point in points[1:]
    )
    same = _same_creep(results)
    return (
        f"Creep widens a bed of {CREEP_SIZE} grains at the end of the cycle by {listed} times de "
        "Paula's step of 1e-6 T: in proportion to the step, until the bed can give way no more. "
        f"A threshold of ten times de Paula's leaves the end at {wide.value:.2f} D (with de "
        f"Paula's {_at_source_step(points):.2f} D). A grain that chatters drifts along the force "
        "on it at about a step times its acceleration, so that creep is step times time: a cycle "
        f"that is {HASTE:g} times faster at a step {HASTE:g} times longer creeps as far{same}."
    )


def _at_source_step(points: Sequence[Creep]) -> float:
    return next(point.end.value for point in points if point.step == 1.0)


def _same_creep(results: Results) -> str:
    """Ends by de Paula's own cycle, and by the accelerated point."""
    words = []
    for n in SIZES:
        slow = mean_of(f"direct {n}, source's friction", "half_end_D", protocol="published")
        fast = mean_of(f"direct {n}, both causes", "half_end_D", protocol=ACCELERATED.name)
        pair = slow(results), fast(results)
        if pair[0] is not None and pair[1] is not None:
            words.append(f"{pair[1].value:.2f} D for {pair[0].value:.2f} D at {n}")
    return f" ({', '.join(words)} grains)" if words else ""


def grid_of_steps(points: Sequence[Creep]) -> np.ndarray:
    """Steps, ends and half intervals as columns."""
    return np.array([(point.step, point.end.value, point.end.half_width() or 0.0) for point in points]).T
