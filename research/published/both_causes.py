"""Mean distances of [D, Table 3.1] with both causes of their hysteresis, and the creep of grains."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from granular.shared.blocks import Table
from research.published.entry import PLAIN, judge_difference_from_published
from research.published.finding import Finding
from research.published.measures import make_mean_measure, pooled_deviation_and_freedom
from research.published.plan import SIZES
from research.published.protocols import ACCELERATED, HASTE
from research.published.results import PublishedResults
from research.published.start_and_creep import FITTED_SIZE, GRID, STEPS, creep_name_suffix
from research.published.velocity_variants import LATE_HASTE, LATE_SEEDS
from validation.measured_quantities import published_value

COLUMNS = (
    ("start", "half_start_D", "half_mean_distance.start"),
    ("end", "half_end_D", "half_mean_distance.end"),
    ("hysteresis", "hysteresis_D", "hysteresis_of_distance.hysteresis"),
)
CREEP_SIZE = 368
"""Number of grains of the bed whose step and threshold were changed."""


class DistanceWithBothCauses(NamedTuple):
    """A distance of Table 3.1 without and with both causes [D].

    Attributes
    ----------
    grains : int
    what : str
        ``"start"``, ``"end"`` or ``"hysteresis"``.
    published : float
    usual, both : Finding
        Results of the exact law from the usual grid, and with both causes.
    late : Finding or None
        Result with both causes and the velocity of [D, eq. 2.17] one step late, by an independent loop; None
        if it was not run.
    allowed, late_allowed : float
        Half widths of the prediction intervals with both causes, from the pooled scatter of all sizes.
    usual_within, within, late_within : bool
        True if the published number lies in the prediction interval.
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


def distances_with_both_causes(results: PublishedResults) -> list[DistanceWithBothCauses]:
    """Return every distance with complete runs, column by column."""
    rows = []
    beds = [f"direct {n}" for n in SIZES]
    changed = [f"{name}, both causes" for name in beds]
    for what, figure, key in COLUMNS:
        for k, count in enumerate(SIZES):
            usual = make_mean_measure(beds[k], figure, pool=beds)(results)
            both = make_mean_measure(changed[k], figure, pool=changed, protocol=ACCELERATED.name)(results)
            late = _late_velocity_finding(results, what, count, figure, changed)
            if usual is None or both is None:
                continue
            published = float(published_value(f"{key}[{k}]"))
            verdicts = [
                judge_difference_from_published(published, None, finding, PLAIN, 2)
                for finding in (usual, both, late)
            ]
            allowed = [judged.allowed or 0.0 for judged in verdicts]
            within = [judged.agrees is True for judged in verdicts]
            rows.append(
                DistanceWithBothCauses(
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


def _late_velocity_finding(
    results: PublishedResults, what: str, count: int, figure: str, beds: Sequence[str]
) -> Finding | None:
    """Return the independent loop's result, with the scatter of the beds with both causes."""
    names = [f"{count}, {seed}" for seed in LATE_SEEDS]
    ends = {
        when: [results.calculated_number("late_velocity", f"{when} {name}") for name in names]
        for when in ("start", "end")
    }
    pooled = pooled_deviation_and_freedom(results, beds, figure, ACCELERATED.name)
    if pooled is None or None in ends["start"] + ends["end"]:
        return None
    start, end = (np.array(ends[when], dtype=float) for when in ("start", "end"))
    values = {"start": start, "end": end, "hysteresis": start - end}[what]
    spread, freedom = pooled
    error = spread / len(values) ** 0.5
    return Finding(float(values.mean()), spread, len(values), "late", error=error, freedom=float(freedom))


def count_distances_within_intervals(rows: Sequence[DistanceWithBothCauses]) -> dict[str, int]:
    """Return the numbers of distances in their prediction intervals, without and with both causes."""
    return {
        "distances": len(rows),
        "within by the exact law": sum(row.usual_within for row in rows),
        "within with both causes": sum(row.within for row in rows),
        "run with equation 2.17 late": sum(row.late is not None for row in rows),
        "within with equation 2.17 late": sum(row.late_within for row in rows),
    }


def both_causes_text(results: PublishedResults) -> str:
    """Return the text on the causes, and on the number of distances that they explain."""
    rows = distances_with_both_causes(results)
    if not rows:
        return "Both causes of the hysteresis together: not run."
    number = count_distances_within_intervals(rows)
    return (
        "The published hysteresis of the mean distance (its value at the start minus its value at the end "
        "of the cycle) is smaller than the simulated one. Two causes of this difference were found, whose "
        "effects add. First, with de Paula's regularised friction at the published time step, grains "
        "chatter about equilibrium and creep, which increases the mean distance at the end. Second, the "
        "initial grid of grains, whose height the thesis does not give, was probably higher than in the "
        "simulations here, which decreases the mean distance at the start. If both causes are simulated, "
        f"{number['within with both causes']} of {number['distances']} published values (starts, ends and "
        "differences) lie in their prediction intervals. The intervals follow from the spread over packings "
        f"of all sizes together. In these simulations the grid is {GRID:g} times as high as the initial "
        "height of the piston; this factor was fitted only to the start value for "
        f"{FITTED_SIZE} grains. With exact friction and the usual grid, only "
        f"{number['within by the exact law']} of the published values lie in their intervals."
        f"{_late_velocity_text(rows)}"
    )


def _late_velocity_text(rows: Sequence[DistanceWithBothCauses]) -> str:
    """Return the text on the effect of the velocity in the friction law on the distances."""
    late = [row for row in rows if row.late is not None]
    if not late:
        return ""
    return (
        " The speed of creep depends on the velocity that is inserted into the friction law. In the column "
        '"2.17 late" this velocity is calculated by equation 2.17 of the thesis for the previous step, '
        "because the current value is not yet known when the friction is computed. This column was "
        "computed by a separate program, with one run for each size and a cycle "
        f"{LATE_HASTE:g} times faster at a step {LATE_HASTE:g} times longer; "
        f"{sum(row.late_within for row in late)} of {len(late)} published values lie in their intervals."
    )


def distance_table(results: PublishedResults) -> Table:
    """Return the table of start, end and hysteresis by size; a star marks values outside their intervals."""
    rows = distances_with_both_causes(results)
    cells = {(row.grains, row.what): _distance_cells(row) for row in rows}
    sizes = list(dict.fromkeys(row.grains for row in rows))
    names = [what for what, _, _ in COLUMNS]
    blank = ("", "", "")
    header = ("N", *(f"{what}: {who}" for what in names for who in ("published", "both causes", "2.17 late")))
    return Table(
        header, [(n, *(cell for what in names for cell in cells.get((n, what), blank))) for n in sizes]
    )


def _distance_cells(row: DistanceWithBothCauses) -> tuple[str, str, str]:
    """Return the published value, with both causes, and with the late velocity [D]."""
    both = f"{row.both.value:.2f}{'' if row.within else '*'}"
    late = "" if row.late is None else f"{row.late.value:.2f}{'' if row.late_within else '*'}"
    return f"{row.published:.2f}", both, late


class CreepAtStep(NamedTuple):
    """Half the mean distance at the end [D], and the step [1e-6 T]."""

    step: float
    end: Finding


def final_distance_with_creep_by_step(results: PublishedResults) -> list[CreepAtStep]:
    """Return the creep of `CREEP_SIZE` grains by step, starting with the exact law (step 0)."""
    usual = make_mean_measure(f"direct {CREEP_SIZE}", "half_end_D")(results)
    names = [f"direct {CREEP_SIZE}, {creep_name_suffix(step)}" for step in STEPS]
    creeping = [
        make_mean_measure(name, "half_end_D", pool=names, protocol=ACCELERATED.name)(results)
        for name in names
    ]
    ends = zip((0.0, *STEPS), (usual, *creeping), strict=True)
    return [CreepAtStep(x, end) for x, end in ends if end is not None]


def creep_text(results: PublishedResults) -> str:
    """Return the text on creep as a function of step, time and threshold."""
    points = final_distance_with_creep_by_step(results)
    name = f"direct {CREEP_SIZE}, threshold ten times"
    wide = make_mean_measure(name, "half_end_D", protocol=ACCELERATED.name)(results)
    if len(points) < 2 or wide is None:
        return "How creep grows with the step: not run."
    return (
        "The distance by which grains creep is proportional to the time step, until the bed cannot expand "
        "any further. With a threshold speed ten times as high as de Paula's, half the mean distance at "
        f"the end is {wide.value:.2f} D instead of {_final_distance_at_source_step(points):.2f} D "
        f"({CREEP_SIZE} grains). A chattering grain drifts in the direction of the force on it; the "
        "speed of this drift is about the grain's acceleration times the step. The creep distance is "
        f"therefore proportional to the product of step and time: a cycle {HASTE:g} times faster with a step "
        f"{HASTE:g} times longer gives the same mean distances at the end."
    )


def creep_table(results: PublishedResults) -> Table:
    """Return the table of the increase of the final distance by creep [D], over the step."""
    points = final_distance_with_creep_by_step(results)
    header = ("step / 1e-6 T", *(f"{point.step:g}" for point in points[1:]))
    wider = [f"{point.end.value - points[0].end.value:.2f} D" for point in points[1:]]
    return Table(
        header,
        [(f"increase of half the mean distance at the end, {CREEP_SIZE} grains", *wider)] if wider else [],
    )


def _final_distance_at_source_step(points: Sequence[CreepAtStep]) -> float:
    return next(point.end.value for point in points if point.step == 1.0)


def accelerated_cycle_table(results: PublishedResults) -> Table:
    """Return the table of final distances by de Paula's cycle, and by the accelerated one."""
    ends = []
    for n in SIZES:
        slow = make_mean_measure(f"direct {n}, source's friction", "half_end_D", protocol="published")
        fast = make_mean_measure(f"direct {n}, both causes", "half_end_D", protocol=ACCELERATED.name)
        pair = slow(results), fast(results)
        if pair[0] is not None and pair[1] is not None:
            ends.append((n, pair[0].value, pair[1].value))
    header = ("half the mean distance at the end, N", *(str(n) for n, _, _ in ends))
    rows = [
        ("published cycle and step", *(f"{slow:.2f} D" for _, slow, _ in ends)),
        (
            f"cycle {HASTE:g} times faster, step {HASTE:g} times longer",
            *(f"{fast:.2f} D" for _, _, fast in ends),
        ),
    ]
    return Table(header, rows if ends else [])


def steps_distances_and_half_intervals(points: Sequence[CreepAtStep]) -> np.ndarray:
    """Return steps, final distances and half intervals as columns."""
    return np.array([(point.step, point.end.value, point.end.half_width() or 0.0) for point in points]).T
