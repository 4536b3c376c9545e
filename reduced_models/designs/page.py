"""The page of the maps, and their pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.shared.html_pages import HtmlPage, format_number
from granular.shared.plotting import COLOURS, figure
from granular.shared.version import versions
from reduced_models.designs.damper import (
    DIAMETER,
    HIGHEST,
    LOWEST,
    NAMES,
    DamperCandidate,
    damper_at_coordinates,
)
from reduced_models.designs.maps import DamperMaps

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["plot_maps"]

_SIDE = 41
_SHORTEST = 15
"""Points of a line that is drawn: shorter ones are corners of the map, with no room for a label."""


class ContourStyle(NamedTuple):
    """The look of the lines of one figure on a map."""

    words: str
    factor: float
    levels: Any
    colour: str
    style: Any


DARK = "#54585e"
LINES = {
    "frequency": ContourStyle("frequency [Hz]", 1.0, 6, COLOURS[0], "-"),
    "damping_ratio": ContourStyle(
        "damping ratio", 1.0, (0.02, 0.03, 0.05, 0.1, 0.2, 0.3, 0.4), COLOURS[1], "--"
    ),
    "rest_height": ContourStyle("height of rest [D]", 1.0 / DIAMETER, 6, DARK, ":"),
}
ENDS: dict[str, tuple[int, Any, tuple[int, int], tuple[str, str]]] = {
    "frequency": (1, np.argmin, (0, -2), ("center", "top")),
    "damping_ratio": (0, np.argmax, (3, 0), ("left", "center")),
    "rest_height": (1, np.argmax, (0, 2), ("center", "bottom")),
}
"""Place of a line's label: axis, which end along it, offset in points, and alignment."""
COUNTS, FRACTIONS = (92, 184, 368), (0.0, 0.5)
"""Beds that the page of maps shows."""


def maps_page(maps: DamperMaps, sliders: str | None = None) -> HtmlPage:
    """All maps as a page: pictures, their errors, and the law that they hold for."""
    page = HtmlPage(
        "Maps of the damper",
        f"What {len(maps.dampers)} simulated dampers say of frequency, damping and height of rest.",
    )
    page.add_paragraph(
        "A map is a polynomial in the coordinates below, fitted to the study. Its "
        "error is that of predicting a damper which the fit did not see (leave-one-out)."
    )
    if sliders is not None:
        page.add_link("The maps under sliders: move them and see the swing", sliders)
    page.add_table(
        ("figure", "error of its map"),
        [
            ("height of rest", _percent_text(maps.surfaces["rest_height"].error)),
            ("frequency of the undamped small swing", _percent_text(maps.surfaces["frequency"].error)),
            ("damping ratio", _percent_text(maps.surfaces["damping_ratio"].error)),
            ("k2 h/k1 of the law", format_number(maps.surfaces["quadratic"].error, 2)),
            ("k3 h²/k1 of the law", format_number(maps.surfaces["cubic"].error, 2)),
        ],
    )
    page.add_table(
        ("coordinate", "from", "to"),
        [
            (name, format_number(low), format_number(high))
            for name, low, high in zip(NAMES, LOWEST, HIGHEST, strict=True)
        ],
    )
    for fraction in FRACTIONS:
        words = "equal grains" if fraction == 0.0 else f"{100.0 * fraction:g} % small grains"
        page.add_figure(
            plot_maps(maps, fraction),
            f"{words}: frequency, damping ratio and height of rest over the piston's mass and the "
            "drag of a grain.",
        )
    page.add_section("The law")
    page.add_paragraph(
        "The motion about rest follows z'' + 2 lam z' + k1 (z - h) + k2 (z - h)^2 + k3 (z - h)^3 "
        "= 0 with k1 = (2 pi f)^2 and lam = damping ratio times 2 pi f; k2 and k3 are mapped as "
        "k2 h/k1 and k3 h^2/k1. A lift of 0.2 D leaves the cubic term of strongly damped dampers "
        "open: its map says little there."
    )
    page.add_table(
        (
            "grains",
            "mass [kg]",
            "drag [kg/s]",
            "h [D]",
            "f [Hz]",
            "damping ratio",
            "lam [1/s]",
            "k1 [1/s²]",
            "k2 [1/(m s²)]",
            "k3 [1/(m² s²)]",
        ),
        [
            _law_row(maps, damper_at_coordinates(np.array([mass, grains, drag, -1.0])))
            for grains in (-1.0, 0.0, 1.0)
            for mass in (-0.6, 0.6)
            for drag in (-0.6, 0.4)
        ],
    )
    page.add_footer("Made with " + ", ".join(f"{k} {v}" for k, v in versions().items()))
    return page


def _percent_text(value: float) -> str:
    return f"{100.0 * value:.2g} %"


def _law_row(maps: DamperMaps, candidate: DamperCandidate) -> tuple[str, ...]:
    said = maps.predict(candidate)
    values = (
        candidate.mass,
        candidate.drag,
        said.rest_height / DIAMETER,
        said.frequency,
        said.damping_ratio,
        said.lam,
        said.k1,
        said.k2,
        said.k3,
    )
    return (str(candidate.grains), *(format_number(value, 3) for value in values))


def plot_maps(maps: DamperMaps, fraction: float = 0.0) -> Figure:
    """Draw contours of frequency, damping ratio and height of rest for 92, 184 and 368 grains.

    Parameters
    ----------
    maps : DamperMaps
        Maps of a study of dampers.
    fraction : float
        Fraction of small grains, from 0 to 0.5.

    Returns
    -------
    Figure
        Picture with one panel a number of grains, over mass [kg] and drag of a grain [kg/s].
    """
    with figure(1, len(COUNTS), width=10.0, height=3.6) as (drawing, axes):
        for panel, count in zip(axes, COUNTS, strict=True):
            draw_contour_map(panel, maps, count, fraction)
            panel.set_title(f"{count} grains", fontsize=10)
        add_map_legend(drawing)
        axes[0].set_ylabel("drag of a grain [kg/s]")
        return drawing


def draw_contour_map(axes: Axes, maps: DamperMaps, count: int, fraction: float) -> None:
    """Draw the contours of the maps over mass and drag, in which their box is sheared."""
    side = np.linspace(-1.0, 1.0, _SIDE)
    grains = DamperCandidate(1.0, count, 1.0, fraction).map_coordinates()[[1, 3]]
    positions = [[np.array([damper, grains[0], other, grains[1]]) for damper in side] for other in side]
    dampers = [[_damper_at_grain_count(coordinates, count) for coordinates in row] for row in positions]
    mass = np.array([[damper.mass for damper in row] for row in dampers])
    drag = np.array([[damper.drag for damper in row] for row in dampers])
    for name, damper in LINES.items():
        values = damper.factor * np.exp(
            [[maps.figure_at(name, coordinates) for coordinates in row] for row in positions]
        )
        lines = axes.contour(mass, drag, values, damper.levels, colors="none")
        for level, segments in zip(lines.levels, lines.allsegs, strict=True):
            longest: np.ndarray = max(segments, key=len, default=np.empty((0, 2)))
            if len(longest) > _SHORTEST:
                axes.plot(*longest.T, damper.style, color=damper.colour, linewidth=1.1)
                _label_contour(axes, name, float(level), longest)
    axes.set_xlim(mass.min() / 1.12, mass.max() * 1.12)
    axes.set_ylim(drag.min() / 1.4, drag.max() * 1.3)
    axes.set_xscale("log")
    axes.set_yscale("log")
    for values, ticks, set_ticks in (
        (mass, (0.75, 1, 1.5, 2, 3, 5, 7.5, 10), axes.set_xticks),
        (drag, (0.02, 0.05, 0.1, 0.2, 0.5, 1, 2), axes.set_yticks),
    ):
        shown = [tick for tick in ticks if values.min() <= tick <= values.max()]
        set_ticks(shown, [f"{tick:g}" for tick in shown])
        set_ticks([], minor=True)
    axes.set_xlabel("mass of the piston [kg]")


def _label_contour(axes: Axes, name: str, level: float, line: np.ndarray) -> None:
    """Level at an end of its line, where no other line has its labels."""
    along, end, offset, (left, top) = ENDS[name]
    axes.annotate(
        f"{level:g}",
        line[end(line[:, along])],
        offset,
        textcoords="offset points",
        ha=left,
        va=top,
        color=LINES[name].colour,
        fontsize=8,
        annotation_clip=False,
    )


def add_map_legend(drawing: Figure) -> None:
    """Name the lines of a map, above it."""
    from matplotlib.lines import Line2D

    drawing.legend(
        handles=[
            Line2D([], [], color=line.colour, linestyle=line.style, label=line.words)
            for line in LINES.values()
        ],
        loc="outside upper center",
        ncols=len(LINES),
    )


def _damper_at_grain_count(coordinates: np.ndarray, count: int) -> DamperCandidate:
    """Damper at a place, with the number of grains of the picture."""
    return damper_at_coordinates(coordinates)._replace(grains=count)
