"""The workshop sheet of a damper: what to build, what it costs to be off, and what to measure.

What a percent costs are the slopes of the settled bed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from granular.linear import piston_roots, slopes
from granular.linear.equilibrium import Equilibrium
from granular.parts.grades import GRADES, REMANENCE_SLOPE
from granular.parts.liquids import silicone_oil_viscosity_ratio
from granular.scene.scene import Scene
from granular.shared.errors import InputError
from granular.shared.html_pages import HtmlPage, format_number
from granular.shared.plotting import COLOURS, GREY, figure
from granular.shared.version import versions
from reduced_models.falls.workshop_parts import GAP_COLUMNS, gap_rows, limit_lines, part_rows, walls_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TEMPERATURES = (5.0, 15.0, 25.0, 35.0, 45.0)
"""[deg C]"""
SIZES = ((3, 1), (4, 2), (5, 2), (5, 3), (6, 2), (6, 3), (8, 3), (10, 3))
"""Diameter and thickness of discs that many sellers stock [mm]."""
_BLANK = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}
_DRAG = "effects.drag.coefficient"
_KEYS = {
    "mass of the piston": "piston.mass",
    "remanence of the discs": "grains.remanence",
    "drag of a disc": _DRAG,
    "width of the cell": "cell.width",
    "diameter of the first discs": "grains.species.0.diameter",
    "thickness of the discs": "grains.thickness",
}


def workshop_sheet(
    scene: Scene,
    rest: float,
    bed: Equilibrium | None,
    *,
    amplitude: float,
    title: str,
    lead: str,
    scatter: Sequence[str],
    notes: Sequence[str] = (),
) -> HtmlPage:
    """Page to build a damper from, for a screen or for paper; rest, amplitude of use [m]."""
    by_part: dict[str, list[float]] = {}
    gaps: list[tuple[str, ...]] = []
    limits = ["The bed has no oscillation about an equilibrium, so its limits are not known."]
    if bed is not None:
        try:
            root = piston_roots(bed)[0]
            by_part = slopes_by_part(bed)
            gaps, limits = gap_rows(bed, root, amplitude), limit_lines(bed, root, amplitude)
        except InputError as error:
            notes = [*notes, f"{error}"]
    page = HtmlPage(title, lead)
    for note in notes:
        page.add_warning(note)
    page.add_figure(
        _draw_cell(scene, rest),
        "Front view, all lengths in proportion, in mm. The piston is drawn at rest on discs in a "
        "lattice, the cell up to the height from which the piston is lowered.",
    )
    page.add_section("Parts")
    page.add_table(("part", "number", "dimensions", "mass"), part_rows(scene, rest))
    page.add_paragraph(walls_text(scene))
    _add_walls_note(page, scene)
    page.add_section("Liquid and gap")
    drag = _drag_coefficient(scene)
    liquid = "The damper has no drag, so no liquid."
    if drag:
        liquid = (
            f"A disc needs a drag of {drag:.3g} kg/s: 2 eta A/h of a liquid of the viscosity eta in gaps h "
            "between its faces A and the plates, without flow back between discs."
        )
    page.add_paragraph(
        f"{liquid} Take the narrowest gap into which every disc fits, sorted by thickness: in the play discs "
        "tilt and bear on both plates, with a load that grows as the play (upper bound). Friction is a "
        "damping ratio added to that of the drag at an amplitude of "
        f"{1e3 * amplitude:.3g} mm, with static coefficients of metal on PTFE unless the scene names its "
        "own; if the bed sticks, a run decides."
        f"{'' if scene.effects.friction else ' The simulations had no friction.'}"
    )
    page.add_table(GAP_COLUMNS, gaps)
    page.add_section("Limits of use")
    page.add_list(limits)
    page.add_section("Temperature")
    page.add_paragraph(
        "Over their values at 25 °C: the viscosity of silicone oil, and so the drag (Shin-Etsu, Silicone "
        "Fluid KF-96, Performance Test Results), and the remanence of NdFeB (-0.12 %/K, shanghaimagnet.com)."
    )
    page.add_table(
        ("temperature [°C]", *(f"{value:g}" for value in TEMPERATURES)),
        [
            ("drag", *(format_number(silicone_oil_viscosity_ratio(value), 3) for value in TEMPERATURES)),
            (
                "remanence",
                *(format_number(1.0 + REMANENCE_SLOPE * (value - 25.0), 3) for value in TEMPERATURES),
            ),
        ],
    )
    page.add_section("Discs to buy")
    page.add_paragraph(_disc_sizes_text(scene, by_part))
    page.add_table(
        ("grade", "remanence [T]", "frequency [%]", "damping ratio [%]"), _grade_rows(scene, by_part)
    )
    page.add_section("What a percent costs")
    page.add_paragraph(
        "Changes of the height at rest, and of frequency and damping ratio of small motions of the settled "
        "bed, if one part is one percent more: exact derivatives, of the stiffness of all its pairs."
    )
    page.add_table(
        ("one percent more", "rest [%]", "frequency [%]", "damping ratio [%]"),
        [
            (words, *(f"{rate:+.2f}" for rate in by_part[key]))
            for words, key in _KEYS.items()
            if key in by_part
        ],
    )
    page.add_section("Scatter")
    page.add_list(scatter)
    page.add_section("What to measure first")
    page.add_paragraph(
        "First weigh the piston with all that moves with it. Rest and frequency know the discs' moment m "
        "and the mass M only as m²/M: with M weighed, the height at rest gives the moment. Measure it with "
        "two or more weighed masses, so that a wrong zero of the scale shows. Then, the machine held still, "
        "lift the piston by a fifth of a disc's diameter, release it and record its height for three "
        "seconds, at 200 samples a second or more, as a table of time and height. Read back remanence and "
        "drag, with the mass as weighed, and simulate again:"
    )
    host = " --set effects.host=none" if scene.effects.host else ""  # it is held still
    page.add_preformatted(
        "granular-damper calibrate lab.csv scene.toml --set 'piston.mass=WEIGHED kg' \\\n"
        "    --parameter effects.drag.coefficient --parameter grains.remanence -o out/read-back" + host
    )
    page.add_footer("Made with " + ", ".join(f"{k} {v}" for k, v in versions().items()))
    return page


def slopes_by_part(bed: Equilibrium) -> dict[str, list[float]]:
    """Return d ln (rest, natural frequency, damping ratio) / d ln (number) of each part, by its key."""
    keys = [key for key in _KEYS.values() if key != _DRAG or _drag_coefficient(bed.scene)]
    return dict(zip(keys, slopes(bed, keys).values.tolist(), strict=True))


def _disc_sizes_text(scene: Scene, by_part: Mapping[str, Sequence[float]]) -> str:
    """Sizes that are sold, and whether those of the scene are among them."""
    grains = scene.grains
    own = [
        (round(1e3 * species.diameter, 3), round(1e3 * float(thickness), 3))
        for species, thickness in zip(grains.species, grains.species_values("thickness"), strict=True)
    ]
    odd = [f"{d:g} x {h:g}" for d, h in own if (d, h) not in SIZES]
    fits = f"; {' and '.join(odd)} is none of them, so have it made" if odd else ""
    off = [
        f"{100.0 * by_part[key][0] * 1e-4 / value:.2g} % by the {name}"
        for name, key, value in (
            ("diameter", "grains.species.0.diameter", grains.species[0].diameter),
            ("thickness", "grains.thickness", grains.thickness),
        )
        if key in by_part
    ]
    moved = f", which moves rest by {' and '.join(off)}" if off else ""
    return (
        f"Usual sizes, diameter x thickness in mm, each within 0.1{moved}: "
        f"{', '.join(f'{d} x {h}' for d, h in SIZES)}{fits}. Grades (shanghaimagnet.com), and what "
        "the middle of each does to this damper by the slope at its own remanence:"
    )


def _grade_rows(scene: Scene, by_part: Mapping[str, Sequence[float]]) -> list[tuple[str, ...]]:
    """Each grade with its remanence [T], and the changes [%] that it makes in this damper."""
    own = float(scene.grains.species_values("remanence")[0])
    rates = by_part.get("grains.remanence", ())[1:]
    rows = []
    for name, grade in GRADES.items():
        if not name[-1].isdigit():
            continue  # the same remanence, for higher temperatures
        ratio = grade.remanence / own
        changes = [f"{100.0 * (ratio**rate - 1.0):+.1f}" for rate in rates] or ["", ""]
        rows.append((name, f"{grade.lowest:.2f} to {grade.highest:.2f}", *changes))
    return rows


def _drag_coefficient(scene: Scene) -> float:
    drag = scene.effects.drag
    return 0.0 if drag is None else drag.coefficient


def _add_walls_note(page: HtmlPage, scene: Scene) -> None:
    walls = scene.effects.walls
    laws = set() if walls is None else {wall.law for _, wall in walls.present_walls} - {"discs"}
    if laws:
        page.add_warning(
            f"Walls were simulated by the law {', '.join(sorted(laws))}, not by these rows of magnets, which "
            "lower rest of the packaged damper by about 1 % and its frequency by 3 to 4 %. Design with "
            "magnets='cylinders' to have them in the simulations."
        )


def _draw_cell(scene: Scene, rest: float) -> Figure:
    """Front view of cell, bed and piston, with dimensions [mm]."""
    from matplotlib.patches import Circle, Rectangle

    assert scene.piston is not None
    width, height, level = (1e3 * x for x in (scene.cell.width, scene.piston.height, rest))
    diameter, plate = 1e3 * scene.grains.species[0].diameter, 0.03 * width
    with figure(width=7.2, height=7.2 * (height + 8 * plate) / (1.35 * width)) as (drawing, axes):
        for left in (-plate, width):
            axes.add_patch(Rectangle((left, -plate), plate, height + plate, color=GREY))
        axes.add_patch(Rectangle((0.0, -plate), width, plate, color=GREY))
        axes.add_patch(Rectangle((0.0, level), width, 2.0 * plate, fill=False, hatch="//"))
        for x, y, size in _grain_sites(scene, width, level):
            axes.add_patch(Circle((x, y), 0.5 * size, fill=False, color=COLOURS[0], linewidth=0.6))
        _draw_dimension_line(axes, (0.0, -2.2 * plate), (width, -2.2 * plate), f"{width:.4g}")
        _draw_dimension_line(axes, (width + 2.2 * plate, 0.0), (width + 2.2 * plate, level), f"{level:.4g}")
        _draw_dimension_line(axes, (-2.4 * plate, 0.0), (-2.4 * plate, height), f"{height:.4g}")
        axes.text(
            0.5 * width,
            level + plate,
            f"piston, {scene.piston.mass:.4g} kg",
            ha="center",
            va="center",
            bbox=_BLANK,
        )
        axes.text(
            0.5 * width,
            height,
            f"{scene.grains.count} discs, the first of {diameter:g} mm",
            ha="center",
            va="top",
        )
        axes.set(xlim=(-6 * plate, width + 6 * plate), ylim=(-4.5 * plate, height + 2 * plate))
        axes.set_aspect("equal")
        axes.axis("off")
        return drawing


def _grain_sites(scene: Scene, width: float, level: float) -> list[tuple[float, float, float]]:
    """Discs on a hexagonal lattice that fills the cell up to the level [mm]: x, y, diameter."""
    grains = scene.grains
    sizes = 1e3 * grains.diameters()
    spacing = math.sqrt(width * level / len(sizes) / math.sqrt(0.75))
    across = max(round(width / spacing), 1)
    rows = math.ceil(len(sizes) / across)
    return [
        (
            (k % across + (0.25, 0.75)[k // across % 2]) * width / across,
            (k // across + 0.5) * level / rows,
            float(size),
        )
        for k, size in enumerate(sizes)
    ]


def _draw_dimension_line(axes: Axes, start: tuple[float, float], end: tuple[float, float], text: str) -> None:
    axes.annotate("", start, end, arrowprops={"arrowstyle": "<->", "linewidth": 0.8})
    upright = start[0] == end[0]
    axes.text(
        0.5 * (start[0] + end[0]),
        0.5 * (start[1] + end[1]),
        text,
        ha="center",
        va="center",
        rotation=90 if upright else 0,
        bbox=_BLANK,
    )
