"""The picture of a study: error over time, what to take ringed, the floor as a band."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from granular.shared.plotting import COLOURS, GREY, STYLES
from validation.cost.advice import Advice
from validation.cost.point import Point, families

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw(
    axes: Axes, points: Sequence[Point], front: Sequence[Point], floor: float,
    levels: Mapping[str, Advice],
) -> None:  # fmt: skip
    """Draw error over seconds, a line a family, with the bounds of the errors as thin bars.

    A family's label says how many of its settings failed.
    """
    for k, (name, ones) in enumerate(families(points).items()):
        _draw_family(axes, name, ones, k)
    best = [one for one in front if one.error > 0.0]
    axes.loglog(
        [one.seconds for one in best], [one.error for one in best],
        color=GREY, linewidth=5.0, alpha=0.35, zorder=0, label="best of all",
    )  # fmt: skip
    for words, advice in levels.items():
        axes.axhline(advice.tolerance, color="#333333", linewidth=0.6, linestyle=":")
        _mark(axes, words, advice)
    if floor > 0.0:
        low, high = axes.get_ylim()
        axes.axhspan(low, floor, color=GREY, alpha=0.2, linewidth=0.0)
        axes.set_ylim(low, max(high, 1.2 * floor))
    plain_numbers(axes)
    axes.set_xlabel("wall time [s]")


def _draw_family(axes: Axes, name: str, points: Sequence[Point], k: int) -> None:
    done = [one for one in points if not one.failed and one.error > 0.0]
    failed = sum(one.failed for one in points)
    outside = points[0].setting.outside
    seconds, errors = [one.seconds for one in done], [one.error for one in done]
    colour = COLOURS[k % len(COLOURS)]
    axes.loglog(
        seconds, errors,
        marker="x" if outside else "o", markersize=3.5, color=colour,
        linestyle=":" if outside else STYLES[k // len(COLOURS) % len(STYLES)],
        linewidth=0.9 if outside else 1.5, label=f"{name} ({failed} failed)" if failed else name,
    )  # fmt: skip
    if any(one.doubt > 0.0 for one in done):
        axes.vlines(seconds, errors, [one.bound for one in done], color=colour, linewidth=0.9)


def _mark(axes: Axes, words: str, advice: Advice) -> None:
    """Ring the setting to take for a level, and name it at the level's line."""
    best = advice.point
    if best is not None and not advice.below_floor and best.error > 0.0:
        axes.plot(best.seconds, best.error, "o", markersize=11.0, color="#333333",
                  markerfacecolor="none", markeredgewidth=1.4)  # fmt: skip
    said = f"{advice.starts:.2g} starts" if advice.below_floor else str(advice)
    axes.annotate(
        f"{words}: {said}", (0.99, advice.tolerance), xycoords=("axes fraction", "data"),
        xytext=(0, 3), textcoords="offset points", ha="right", fontsize=8,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
    )  # fmt: skip


def plain_numbers(axes: Axes) -> None:
    """Label seconds as they are read: 0.02, 0.05, 0.1; fewer of them over many decades."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axes.get_xlim()
    subs = (1.0, 2.0, 5.0) if high < 200.0 * low else (1.0,)
    axes.xaxis.set_major_locator(LogLocator(subs=subs))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
