"""The first screen: a picture and a table a scene, what its effects cost, the hard cases' row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from granular.shared.html import Page
from granular.shared.plotting import COLOURS, GREY, STYLES, figure
from validation.cost import FLOORS, LEVELS, USUAL, Advice, WorkPrecision
from validation.cost.advice import duration
from validation.cost.picture import plain_numbers
from validation.effect_costs import agree
from validation.glance import digit
from validation.outcomes import ACCURATE, DEGRADED, STOPPED, Outcome
from validation.parts import Plain
from validation.sections.common import WIDTH, Shown, legend, note_failures, sound, tabulate
from validation.sections.cost import studies
from validation.sections.stability import stability_verdict
from validation.table import TextTable, table

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def glance_section(page: Page, results: Sequence[Plain], outcomes: Sequence[Outcome] = ()) -> None:
    """The three questions of a user, answered for each scene."""
    done = sound(results)
    for one in done:
        if "studies" in one:
            _accuracy(page, one)
        elif "effects" in one:
            _effects(page, one["effects"])
    hard = [Outcome.from_plain(row) for one in done for row in one.get("outcomes", ())]
    if hard or outcomes:
        page.section("Hard cases at a glance")
        tabulate(page, hard_row(hard or outcomes))
    note_failures(page, results)


# Accuracy ---------------------------------------------------------------------------------------


def _accuracy(page: Page, plain: Plain) -> None:
    found = [WorkPrecision.from_plain(one) for one in plain["studies"]]
    first, starts = found[0], plain["starts"]
    page.section(f"{first.scene}: what accuracy costs")
    if starts > 1:
        page.text(
            f"Errors are means over {starts} starts, against a finer step from the same starts; "
            "bars end at the bound that the starts allow. Dashed: how far the starts themselves "
            f"scatter. One run cannot be trusted below {FLOORS:g} times that, whatever its step; "
            "the mean of more starts can, at their price. Where no method is named it is "
            f"{USUAL[0]}."
        )
    with figure(width=WIDTH, height=4.2) as (drawing, axes):
        plot(axes, found)
        legend(axes)
        until = "" if first.horizon is None else f" over {first.horizon:g} s"
        page.figure(drawing, f"{first.scene}{until}: error over the time of a run.")
    tabulate(page, advice_table(found))


def plot(axes: Axes, found: Sequence[WorkPrecision]) -> None:
    """Error over seconds: a colour a quantity, a line a method, the floor dashed."""
    for k, study in enumerate(found):
        colour = COLOURS[k % len(COLOURS)]
        for j, (name, points) in enumerate(study.families().items()):
            done = [one for one in points if not one.failed and one.error > 0.0]
            seconds = [one.seconds for one in done]
            words = study.quantity if j == 0 else f"{study.quantity}, {name}"
            axes.loglog(
                seconds, [one.error for one in done], marker="os^vD"[j % 5], markersize=3.5,
                color=colour, linestyle=STYLES[j % len(STYLES)], linewidth=1.2, label=words,
            )  # fmt: skip
            axes.vlines(seconds, [one.error for one in done], [one.bound for one in done],
                        color=colour, linewidth=0.8)  # fmt: skip
        if study.floor > 0.0:
            axes.axhline(study.floor, color=colour, linestyle=(0, (6, 3)), linewidth=0.9)
    for level in LEVELS.values():
        axes.axhline(level, color=GREY, linewidth=0.6, linestyle=":")
    plain_numbers(axes)
    axes.set_xlabel("time of a run [s]")
    axes.set_ylabel("error")


def advice_table(found: Sequence[WorkPrecision]) -> TextTable:
    """A quantity a row: what to take for each level and its price, scatter, price of a digit."""
    rows = []
    for one in found:
        advised = [one.advice(level) for level in LEVELS.values()]
        scatter = f"{one.floor:.1g}" if one.floor else "none"
        rows.append((one.quantity, *map(_take, advised), scatter, digit(one, advised[0].point)))
    return table(("quantity", *LEVELS, "starts scatter by", "a digit costs"), rows)


def _take(advice: Advice) -> str:
    """What to take for a level, and its price."""
    if advice.point is None:
        return str(advice)
    method, price = advice.point.setting.method, duration(advice.seconds)
    if advice.below_floor:
        number = f"{advice.starts:d}" if advice.starts < 1000 else f"{advice.starts:.0e}"
        return f"{number} starts of any step: {price}"
    named = "" if method == USUAL[0] else f"{method} "
    return f"{named}{advice.point.setting.fineness}: {price}"


# Effects ----------------------------------------------------------------------------------------


def _effects(page: Page, plain: Mapping[str, Any]) -> None:
    page.section(f"{plain['scene']}: what its effects cost")
    page.text(
        f"Microseconds of a step of {plain['grains']} grains on one core, medians of interleaved "
        f"runs: {plain['step']:.3g} with all effects, {plain['nothing']:.2g} with none. An effect "
        "that is added to others may share their work: both prices stand where they differ by "
        "more than a fifth. What a scene does not name leaves nothing in its step; "
        '"python -m benchmarks --part absent" times that beside steps written by hand.'
    )
    tabulate(page, effect_table(plain))
    sums = ", ".join(f"{name} {value:.3g}" for name, value in plain["sums"].items())
    page.text(f"A whole step by the sum over pairs: {sums} microseconds.")


def effect_table(plain: Mapping[str, Any]) -> TextTable:
    """A row an effect: one price, or what it adds first and what it saves last."""
    rows = []
    for one in plain["effects"]:
        first, last = _priced(one, "first"), _priced(one, "last")
        both = one["first"] is not None and one["last"] is not None
        told = "yes" if both and agree(one) else "no"
        rows.append((one["effect"], first, last, told))
    header = ("effect", "adds when it comes first [us]", "saves when taken away last [us]",
              "alike within a fifth")  # fmt: skip
    return table(header, rows)


def _priced(one: Mapping[str, Any], which: str) -> str:
    value, doubt = one[which], one[f"{which}_doubt"]
    return "cannot be run" if value is None else f"{value:.3g} ± {doubt:.1g}"


# Hard cases -------------------------------------------------------------------------------------


def hard_row(found: Sequence[Outcome]) -> TextTable:
    """How many cases ended in which way, in one row."""
    counts = [sum(one.kind == kind for one in found) for kind in (ACCURATE, DEGRADED, STOPPED)]
    wrong = [one.case for one in found if not one.allowed]
    row = (len(found), *counts, ", ".join(wrong) or "none")
    header = ("hard cases", "accurate", "degraded and said so", "stopped by a typed error",
              "ended as they must not")  # fmt: skip
    return table(header, [row])


def _text(results: Sequence[Plain]) -> str:
    lines = []
    for one in results:
        if "studies" in one:
            found = studies([one])
            lines += [f"{found[0].scene}: what accuracy costs", advice_table(found).text(), ""]
        elif "effects" in one:
            plain = one["effects"]
            lines += [f"{plain['scene']}: what its effects cost", effect_table(plain).text(), ""]
        else:
            outcomes = [Outcome.from_plain(row) for row in one["outcomes"]]
            lines.append(hard_row(outcomes).text())
    return "\n".join(lines)


def _verdict(results: Sequence[Plain]) -> tuple[str, bool]:
    fresh = [row for one in results for row in one.get("fresh", ())]
    hard = [Outcome.from_plain(row) for one in results for row in one.get("outcomes", ())]
    missed = [f"{row['quantity']} of {row['scene']} to {row['level']} by {row['setting']}"
              for row in fresh if not row["holds"]]  # fmt: skip
    words = f"{len(fresh) - len(missed)} of {len(fresh)} advised settings hold for a fresh start"
    if missed:
        words += f", not {'; '.join(missed)}"
    if hard:
        words += f"; {stability_verdict(hard).rstrip('.')}"
    return words, not missed and all(one.allowed for one in hard)


GLANCE = Shown(_text, _verdict, glance_section)
