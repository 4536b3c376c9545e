"""Dampers of five sizes: with equal dimensionless groups, and with the same magnets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from granular import damper
from granular.linear import piston_roots
from granular.linear.equilibrium import Equilibrium, equilibrium_from
from granular.scene.scene_in_natural_units import (
    dimensionless_groups,
    lattice_rest_height,
    rescale_scene_to_width,
)
from granular.shared.plotting import READABLE, figure
from granular.studies.bed_slopes import settled_beds
from research.campaign import Plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FACTORS = (0.3, 0.6, 1.0, 2.0, 5.0)
"""Widths over the width of the settled bed."""
MASSES = (3.75, 3.2, 2.6, 2.2, 1.8)
"""Masses of its piston [kg]; it fell with the first one."""
COUNTS = (48, 92, 184, 276, 368)


def figures_of_rescaled_beds(out: Path) -> Iterator[Plain]:
    """Return the figures of one bed in five widths, under a piston of several masses."""
    scene, positions, height = settled_beds(damper(count=92), 1, out=out)[0]
    for mass in MASSES:
        loaded = scene.replace(**{"piston.mass": mass})
        rest = equilibrium_from(loaded, positions, height)
        positions, height = rest.positions, rest.heights
        for factor in FACTORS:
            other = rescale_scene_to_width(loaded, factor * loaded.cell.width)
            yield dimensionless_figures_at_rest(equilibrium_from(other, factor * positions, factor * height))


def figures_of_dampers_of_same_magnets(out: Path) -> Iterator[Plain]:
    """Return figures of five dampers of the packaged magnets, width and piston mass as the root of N."""
    for count in COUNTS:
        yield dimensionless_figures_at_rest(
            equilibrium_from(*settled_beds(damper(count=count, drop=24.0), 1, out=out)[0])
        )


def dimensionless_figures_at_rest(rest: Equilibrium) -> Plain:
    """Return width [m], N, kappa, rest/W, f sqrt(W/g), zeta, and equilibrium over a lattice's."""
    scene, root, height = rest.scene, piston_roots(rest)[0], rest.piston_height or 0.0
    width, kappa, count = scene.cell.width, dimensionless_groups(scene)["kappa"], scene.grains.count
    return {
        "width": width,
        "count": count,
        "kappa": kappa,
        "rest": height / width,
        "frequency": root.frequency * (width / 9.8) ** 0.5,
        "zeta": root.damping_ratio,
        "over lattice": height / lattice_rest_height(count, width, kappa),
    }


def draw_collapse_of_sizes(rows: Sequence[Plain], same: Sequence[Plain]) -> Figure:
    """Draw rest/(N W) over kappa: one bed in five widths, dampers of the same magnets, the lattice."""
    marks = zip(sorted({row["width"] for row in rows}), "osd^v", (16, 13, 10, 7, 4), strict=True)
    with figure(1, 1, width=7.2, height=4.6, size=READABLE) as (drawing, ax):
        for width, mark, size in marks:
            x, y = _kappas_and_rest_heights_per_grain([row for row in rows if row["width"] == width])
            ax.plot(x, y, mark, markersize=size, fillstyle="none", label=f"N = 92, W = {width:.3g} m")
        ax.plot(
            *_kappas_and_rest_heights_per_grain(same),
            "k*",
            markersize=9,
            label="N = 48 to 368, magnets of 6 mm",
        )
        kappa = sorted(row["kappa"] for row in (*rows, *same))
        ax.plot(kappa, [lattice_rest_height(1, 1.0, value) for value in kappa], "k-", label="(1.6675 κ)^0.4")
        ax.set(xscale="log", yscale="log", xlabel="κ", ylabel="rest/(N W)")
        ax.legend(fontsize="x-small")
    return drawing


def _kappas_and_rest_heights_per_grain(rows: Sequence[Plain]) -> tuple[list[float], list[float]]:
    return [row["kappa"] for row in rows], [row["rest"] / row["count"] for row in rows]
