"""The distances of [D, Table 3.1] with both causes of the hysteresis, and the creep of grains."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from granular.shared.blocks import Table
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
"""Number of grains of the bed whose step and threshold were changed."""


class WithBoth(NamedTuple):
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


def with_both_causes(results: Results) -> list[WithBoth]:
    """Return every distance with complete runs, column by column."""
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
    """Return the independent loop's result, with the scatter of the beds with both causes."""
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
    """Return the numbers of distances in their prediction intervals, without and with both causes."""
    return {
        "distances": len(rows),
        "within by the exact law": sum(row.usual_within for row in rows),
        "within with both causes": sum(row.within for row in rows),
        "run with equation 2.17 late": sum(row.late is not None for row in rows),
        "within with equation 2.17 late": sum(row.late_within for row in rows),
    }


def words_on_both(results: Results) -> str:
    """Return the text on the causes, and on the number of distances that they explain."""
    rows = with_both_causes(results)
    if not rows:
        return "Both causes of the hysteresis together: not run."
    number = summary_of_both(rows)
    return (
        "The hysteresis of the mean distance has two causes, which add. At the end of the cycle the "
        "bed is wider: with de Paula's regularised friction at the published step grains chatter "
        "about equilibrium and creep. At its start the bed is narrower: the first grid, whose "
        "height the thesis does not print, is higher. With both causes "
        f"{number['within with both causes']} of {number['distances']} published starts, ends and "
        "hystereses lie in their prediction intervals (from the spread over packings of all sizes "
        f"together). The grid is then {GRID:g} times as high as the first height of the piston; "
        f"this factor was fitted to the start of {FITTED_SIZE} grains alone. With the exact law "
        f"from the usual grid {number['within by the exact law']} distances lie in their intervals."
        f"{_words_on_velocity(rows)}"
    )


def _words_on_velocity(rows: Sequence[WithBoth]) -> str:
    """Return the text on the effect of the velocity in the friction law on the distances."""
    late = [row for row in rows if row.late is not None]
    if not late:
        return ""
    return (
        ' The speed of creep depends on the velocity in the friction law. The column "2.17 late" '
        "uses equation 2.17 of the previous step, the only value that a loop has when it needs the "
        "friction. It comes from an independent loop with one start each, through a cycle "
        f"{LATE_HASTE:g} times faster at a step {LATE_HASTE:g} times longer; "
        f"{sum(row.late_within for row in late)} of {len(late)} distances lie in their intervals."
    )


def table_of_distances(results: Results) -> Table:
    """Return the table of start, end and hysteresis by size; a star marks values outside their intervals."""
    rows = with_both_causes(results)
    cells = {(row.grains, row.what): _distances(row) for row in rows}
    sizes = list(dict.fromkeys(row.grains for row in rows))
    names = [what for what, _, _ in COLUMNS]
    blank = ("", "", "")
    header = ("N", *(f"{what}: {who}" for what in names for who in ("published", "both causes", "2.17 late")))
    return Table(
        header, [(n, *(cell for what in names for cell in cells.get((n, what), blank))) for n in sizes]
    )


def _distances(row: WithBoth) -> tuple[str, str, str]:
    """Return the published value, with both causes, and with the late velocity [D]."""
    both = f"{row.both.value:.2f}{'' if row.within else '*'}"
    late = "" if row.late is None else f"{row.late.value:.2f}{'' if row.late_within else '*'}"
    return f"{row.published:.2f}", both, late


class Creep(NamedTuple):
    """Half the mean distance at the end [D], and the step [1e-6 T]."""

    step: float
    end: Finding


def creep_over_step(results: Results) -> list[Creep]:
    """Return the creep of `CREEP_SIZE` grains by step, starting with the exact law (step 0)."""
    usual = mean_of(f"direct {CREEP_SIZE}", "half_end_D")(results)
    names = [f"direct {CREEP_SIZE}, {creep_name(step)}" for step in STEPS]
    creeping = [mean_of(name, "half_end_D", pool=names, protocol=ACCELERATED.name)(results) for name in names]
    ends = zip((0.0, *STEPS), (usual, *creeping), strict=True)
    return [Creep(x, end) for x, end in ends if end is not None]


def words_on_creep(results: Results) -> str:
    """Return the text on creep as a function of step, time and threshold."""
    points = creep_over_step(results)
    name = f"direct {CREEP_SIZE}, threshold ten times"
    wide = mean_of(name, "half_end_D", protocol=ACCELERATED.name)(results)
    if len(points) < 2 or wide is None:
        return "How creep grows with the step: not run."
    return (
        "Creep is proportional to the step, until the bed cannot give way any further. A threshold "
        f"ten times as high as de Paula's gives an end of {wide.value:.2f} D instead of "
        f"{_at_source_step(points):.2f} D ({CREEP_SIZE} grains). A chattering grain drifts along "
        "the force on it at about its acceleration times the step, so that creep is proportional "
        f"to step times time: a cycle {HASTE:g} times faster at a step {HASTE:g} times longer gives "
        "the same end."
    )


def table_of_creep(results: Results) -> Table:
    """Return the table of the increase of the final distance by creep [D], over the step."""
    points = creep_over_step(results)
    header = ("step / 1e-6 T", *(f"{point.step:g}" for point in points[1:]))
    wider = [f"{point.end.value - points[0].end.value:.2f} D" for point in points[1:]]
    return Table(header, [(f"end wider, {CREEP_SIZE} grains", *wider)] if wider else [])


def _at_source_step(points: Sequence[Creep]) -> float:
    return next(point.end.value for point in points if point.step == 1.0)


def table_of_haste(results: Results) -> Table:
    """Return the table of final distances by de Paula's cycle, and by the accelerated one."""
    ends = []
    for n in SIZES:
        slow = mean_of(f"direct {n}, source's friction", "half_end_D", protocol="published")
        fast = mean_of(f"direct {n}, both causes", "half_end_D", protocol=ACCELERATED.name)
        pair = slow(results), fast(results)
        if pair[0] is not None and pair[1] is not None:
            ends.append((n, pair[0].value, pair[1].value))
    header = ("end of the cycle, N", *(str(n) for n, _, _ in ends))
    rows = [
        ("published cycle and step", *(f"{slow:.2f} D" for _, slow, _ in ends)),
        (f"{HASTE:g} times faster and longer", *(f"{fast:.2f} D" for _, _, fast in ends)),
    ]
    return Table(header, rows if ends else [])


def grid_of_steps(points: Sequence[Creep]) -> np.ndarray:
    """Return steps, final distances and half intervals as columns."""
    return np.array([(point.step, point.end.value, point.end.half_width() or 0.0) for point in points]).T
