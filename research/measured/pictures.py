"""Pictures of the page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from granular.scene.dimensionless_groups import lattice_rest
from granular.shared.plotting import READABLE, figure
from research.campaign import Plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARKS = "osd^v"
CURVES = ("deviation", "skewness"), ("pentagons", "hexagons", "heptagons")


def draw_mixtures(rows: Sequence[Plain]) -> Figure:
    """Deviation and skewness of the cells' areas, and their polygons, over the ratio of small magnets."""
    rows = sorted(rows, key=lambda row: row["ratio"])
    ratio = [row["ratio"] for row in rows]
    with figure(1, 2, width=11.0, height=4.2, size=READABLE) as (drawing, axes):
        for ax, names in zip(axes, CURVES, strict=True):
            for name, mark in zip(names, MARKS, strict=False):
                ax.plot(ratio, [row[name] for row in rows], f"{mark}-", label=name)
            ax.axvline(0.5, color="k", linestyle=":", linewidth=1.0)
            ax.set(xlabel="ratio of small magnets")
            ax.legend(fontsize="small")
    return drawing


def draw_sizes(rescaled: Sequence[Plain], same: Sequence[Plain]) -> Figure:
    """rest/(N W) over kappa: one bed in five widths, dampers of the same magnets, and the lattice."""
    with figure(1, 1, width=7.2, height=4.6, size=READABLE) as (drawing, ax):
        for width, mark in zip(sorted({row["width"] for row in rescaled}), MARKS, strict=True):
            rows = [row for row in rescaled if row["width"] == width]
            sizes = 4.0 + 3.0 * (len(MARKS) - MARKS.index(mark))
            label = f"N = 92, W = {width:.3g} m"
            ax.plot(*_points(rows), mark, markersize=sizes, fillstyle="none", label=label)
        ax.plot(*_points(same), "k*", markersize=9, label="N = 48 to 736, magnets of 6 mm")
        every = [row["kappa"] for row in (*rescaled, *same)]
        ends = 0.7 * min(every), 1.4 * max(every)
        ax.plot(ends, [lattice_rest(1, 1.0, end) for end in ends], "k-", label="(1.6675 κ)^0.4")
        ax.set(xscale="log", yscale="log", xlabel="κ", ylabel="rest/(N W)")
        ax.legend(fontsize="x-small")
    return drawing


def _points(rows: Sequence[Plain]) -> tuple[list[float], list[float]]:
    return [row["kappa"] for row in rows], [row["rest"] / row["count"] for row in rows]
