"""What accuracy costs: pictures, and which setting to take."""

from __future__ import annotations

import math
from collections.abc import Sequence

from granular.shared.html import Page
from granular.shared.plotting import figure
from validation.cost import LEVELS, USUAL, WorkPrecision
from validation.parts import Plain
from validation.sections.common import WIDTH, Shown, legend, note_failures, sound, tabulate
from validation.table import TextTable, table


def studies(results: Sequence[Plain]) -> list[WorkPrecision]:
    """The studies of all pieces."""
    return [WorkPrecision.from_plain(plain) for one in results for plain in one["studies"]]


def work_precision_section(page: Page, results: Sequence[Plain]) -> None:
    """A picture and a table a quantity, and which setting to take."""
    found = studies(sound(results))
    page.section("What accuracy costs")
    page.text(
        "Error over wall time, warm, the least of the repeats. The broad line joins the settings "
        "that none beats in both. Where several starts were run, the error is the mean deviation "
        "over them and a thin bar ends at its bound. What to take for each level is ringed, and "
        "named at the dotted lines: the fastest setting whose bound is within it, and behind which "
        "no shorter step is clearly above it. The shaded band is the scatter over random starts; "
        "below three times that any setting will do, and the mean of more starts is the price. The "
        "toolkit's seconds hold its records, ledger and start-up; those of SciPy and diffrax "
        "(thin, dotted) the bare integration. The last column is the time over that of the default "
        "setting, stormer-verlet at dt = auto."
    )
    tabulate(page, choices(found))
    for one in found:
        with figure(width=WIDTH, height=5.0) as (drawing, axes):
            one.plot(axes)
            legend(axes)
            until = "" if one.horizon is None else f" over {one.horizon:g} s"
            page.figure(drawing, f"{one.quantity} of {one.scene}{until}, against {one.reference}.")
    note_failures(page, results)


def choices(found: Sequence[WorkPrecision]) -> TextTable:
    """Which setting to take for each level, and what it takes beside the default one."""
    rows = []
    for one in found:
        usual = one.usual()
        seconds = math.nan if usual is None else usual.seconds
        rows += [
            (one.scene, one.quantity, words, *_chosen(one, level, seconds))
            for words, level in LEVELS.items()
        ]
    header = ("scene", "quantity", "to", "take", "dt", "error", "starts", "seconds",
              "of the default's")  # fmt: skip
    return table(header, rows)


def _chosen(one: WorkPrecision, level: float, usual: float) -> tuple[str, ...]:
    advice = one.advice(level)
    best = advice.point
    if best is None:
        return (str(advice), "", "", "", "", "")
    take = best.setting.family
    if advice.below_floor:
        take = f"any: starts scatter by {advice.floor:.2g}"
    ratio = advice.seconds / usual
    return (
        take, best.setting.fineness, f"{best.error:.2g}", f"{advice.starts:.3g}",
        f"{advice.seconds:.3g}", "" if math.isnan(ratio) else f"{ratio:.3g}",
    )  # fmt: skip


def _text(results: Sequence[Plain]) -> str:
    found = studies(results)
    tables = [f"{one.quantity} of {one.scene}\n{one.table().text()}\n" for one in found]
    return "\n".join([*tables, choices(found).text()])


def _verdict(results: Sequence[Plain]) -> tuple[str, bool]:
    found = studies(results)
    usual = [one for one in found if any(each.setting[:2] == USUAL for each in one.points)]
    right = sum(one.usual() is not None for one in usual)
    words = (
        f"cost of accuracy shown for {len(found)} quantities; the default setting runs in "
        f"{right} of {len(usual)}"
    )
    return words, right == len(usual)


def _measurements(page: Page, results: Sequence[Plain]) -> None:
    for one in studies(results):
        page.text(f"Cost of the {one.quantity} of {one.scene}; a star marks the best of all.")
        tabulate(page, one.table())


WORK_PRECISION = Shown(_text, _verdict, work_precision_section, _measurements)
