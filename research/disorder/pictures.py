"""Pictures of temperature, forces and slip, from the rows of the campaign."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from granular.shared.plotting import COLOURS, GREY, figure
from research.disorder.beds import GROUPS
from research.disorder.candidates import CANDIDATES, ORDERS
from research.disorder.cycles import FRAMES as FRAMES_OF_CYCLE
from research.disorder.cycles import SHOWN as KEPT
from research.disorder.dislocation_strain import (
    PARTS,
    WINDOW,
    changes_over_frames,
    distinct_rows,
    fit_dislocation_strain_fraction,
)
from research.disorder.force_heterogeneity import QUIET, SHELLS
from research.disorder.forces import FRAMES, KINDS, mean_with_bootstrap_interval
from research.disorder.temperature import AGITATED, judge_candidates_by_order

Row = Mapping[str, Any]

SHOWN = ("kinetic", "configurational", "piston")
MELTING = 0.100
_MARKS = dict(zip(GROUPS, "os^D", strict=True))
_LEAST = 3e-6


def draw_orders_and_skills(rows: Sequence[Row]) -> Any:
    """Draw the orders over three temperatures, and the skill of each candidate."""
    judged = [judge_candidates_by_order(rows, item) for item in (GROUPS, AGITATED)]
    with figure(3, 4, width=11.5, height=8.6, sharey="row") as (drawing, table):
        for line, (order, words) in zip(table, ORDERS.items(), strict=True):
            for axes, name in zip(line, SHOWN, strict=False):
                for k, group in enumerate(GROUPS):
                    some = [row for row in rows if row["group"] == group]
                    axes.plot(
                        *_values_clipped_for_log_axes(some, name, order),
                        _MARKS[group],
                        color=COLOURS[k],
                        markersize=4.0,
                        fillstyle="none",
                        label=group,
                    )
                axes.axvline(MELTING, color=GREY, linestyle=":")
                axes.set(xscale="log", xlim=(0.7 * _LEAST, 2.0))
            line[0].set_ylabel(textwrap.fill(words, 24))
            if order == "lindemann":
                line[0].set(yscale="log", ylim=(0.7 * _LEAST, 5.0))
            line[3].remove()
        for axes, name in zip(table[-1], SHOWN, strict=False):
            axes.set_xlabel(f"{name} [pair energy]")
        for index, order in enumerate(ORDERS):
            axes = drawing.add_subplot(3, 4, 4 * index + 4)
            _draw_skills(axes, judged, order, last=index == 2)
        table[0, 0].legend(loc="upper left", fontsize=8)
    return drawing


def _values_clipped_for_log_axes(rows: Sequence[Row], name: str, order: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the values to draw: values near zero are placed at the edge of logarithmic axes."""
    x = np.maximum([row[name] for row in rows], _LEAST)
    y = np.array([row[order] for row in rows])
    return x, np.maximum(y, _LEAST) if order == "lindemann" else y


def _draw_skills(axes: Any, judged: Sequence[Any], order: str, *, last: bool) -> None:
    looks = ((GREY, "D", "all four", 0.15), (COLOURS[0], "o", "bath, shaken", -0.15))
    for result, (colour, mark, words, offset) in zip(judged, looks, strict=True):
        for index, name in enumerate(CANDIDATES):
            item = result[name, order].skill
            at = len(CANDIDATES) - index + offset
            axes.plot([max(item.low, -1.0), item.high], [at, at], color=colour, linewidth=1.2)
            axes.plot(
                max(item.value, -1.0),
                at,
                mark,
                color=colour,
                markersize=3.5,
                label=words if index == 0 else None,
            )
    axes.set(xlim=(-1.05, 1.0), yticks=range(len(CANDIDATES), 0, -1))
    axes.set_yticklabels(CANDIDATES, fontsize=8)
    axes.axvline(0.0, color="black", linewidth=0.8)
    if last:
        axes.set_xlabel("skill on held-out driving")
        axes.legend(fontsize=7, loc="lower left")


def draw_unevenness_and_cycle(forces: Sequence[Row], cycles: Sequence[Row]) -> Any:
    """Draw the unevenness around defects in space and time, and a cycle with the dislocations' strain."""
    with figure(2, 2, width=10.5, height=7.0) as (drawing, ((first, second), (third, fourth))):
        for k, kind in enumerate(KINDS):
            some = [row for row in forces if row["kind"] == kind]
            _draw_unevenness_by_neighbour_steps(first, some, kind, COLOURS[k])
            for name, style in (("uneven about", "-"), ("force about", "--")):
                _draw_mean_around_arrivals(
                    second, some, name, f"{name.split()[0]}, {kind}", COLOURS[k], style
                )
        second.axvline(0.0, color=GREY, linestyle=":")
        second.set(xlabel="time since a defect has arrived [ms]", ylabel="over that of calm grains")
        for axes in (first, second):
            axes.axhline(1.0, color="black", linewidth=0.8)
        first.set(xlabel="neighbours away from a defect", ylabel="unevenness over calm grains")
        _draw_cycle_strains(third, cycles)
        _draw_strain_increments_and_slopes(fourth, cycles)
        first.set_xticks(range(SHELLS))
        for axes in (first, second, fourth):
            axes.legend(fontsize=8)
        third.legend(fontsize=8, loc="upper left", bbox_to_anchor=(0.02, 1.0))
    return drawing


def _draw_unevenness_by_neighbour_steps(axes: Any, rows: Sequence[Row], kind: str, colour: str) -> None:
    result = [
        mean_with_bootstrap_interval(list(some))
        for some in zip(*(row["shells"] for row in rows), strict=True)
    ]
    values = np.array(result)
    axes.errorbar(
        range(len(values)),
        values[:, 0],
        [values[:, 0] - values[:, 1], values[:, 2] - values[:, 0]],
        fmt="o-",
        color=colour,
        label=f"{kind}, {len(rows)} beds",
        markersize=4.0,
    )


def _draw_mean_around_arrivals(
    axes: Any, rows: Sequence[Row], name: str, words: str, colour: str, style: str
) -> None:
    result = np.array(
        [mean_with_bootstrap_interval(list(some)) for some in zip(*(row[name] for row in rows), strict=True)]
    )
    time = 1e3 * FRAMES * np.arange(-QUIET, QUIET + 1)
    axes.plot(time, result[:, 0], style, color=colour, label=words)
    axes.fill_between(time, result[:, 1], result[:, 2], color=colour, alpha=0.2, linewidth=0)


def _draw_cycle_strains(axes: Any, rows: Sequence[Row]) -> None:
    row = max(rows, key=lambda item: (item["grains"], -item["seed"]))
    lines = {
        "bed, by its bonds": ("plastic",),
        "bed, by the law": ("law",),
        **{f"dislocations, {item}": PARTS[item] for item in ("tracked", "to the rim")},
    }
    for k, (words, parts) in enumerate(lines.items()):
        axes.plot(
            row["driven"],
            sum(np.array(row[part]) for part in parts),
            color=COLOURS[k],
            linewidth=2.2 if k < 2 else 1.0,
            label=words,
        )
    axes.set(xlabel="strain by the piston", ylabel="plastic strain, yy less xx")
    axes.set_title(f"one cycle of {row['grains']} grains", fontsize=10)


def _draw_strain_increments_and_slopes(axes: Any, rows: Sequence[Row]) -> None:
    for k, size in enumerate(sorted({row["grains"] for row in rows})):
        some = [row for row in distinct_rows(rows) if row["grains"] == size]
        x = np.concatenate([changes_over_frames(row["plastic"]) for row in some])
        y = np.concatenate([changes_over_frames(row["moves"]) for row in some])
        item = fit_dislocation_strain_fraction(some, ("moves",))
        words = f"{size} grains: {item.slope:.2f} [{item.low:.2f}, {item.high:.2f}]"
        axes.plot(x, y, "os"[k], color=COLOURS[k], markersize=3.5, fillstyle="none", label=words)
        ends = np.array([x.min(), x.max()])
        axes.fill_between(ends, item.low * ends, item.high * ends, color=COLOURS[k], alpha=0.2)
    axes.plot(ends, ends, color="black", linewidth=0.8, label="all of it")
    duration = WINDOW * KEPT * FRAMES_OF_CYCLE
    axes.set(
        xlabel=f"plastic strain of the bonds in {duration:g} s",
        ylabel="of the dislocations that were followed",
    )
