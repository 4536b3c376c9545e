"""The workshop sheet of a damper: parts, tolerances with their costs, and first measurements.

Tolerances are those of the settled bed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from granular.linear import piston_roots
from granular.linear.equilibrium import Equilibrium
from granular.linear.friction import names_friction
from granular.parts.grades import GRADES, REMANENCE_SLOPE
from granular.parts.liquids import silicone_oil_viscosity_ratio
from granular.scene.scene import Scene
from granular.shared.blocks import (
    Block,
    Caution,
    Heading,
    Items,
    Picture,
    Printout,
    Table,
    Text,
    cautions,
    format_number,
)
from granular.shared.errors import InputError
from granular.shared.html_pages import Page
from granular.shared.plotting import COLOURS, GREY, figure
from granular.studies.tolerance_page import tolerance_blocks
from granular.studies.tolerance_parts import read_parts, usual_parts
from granular.studies.tolerances import Tolerances, tolerances_at
from reduced_models.falls.workshop_parts import GAP_COLUMNS, gap_rows, limit_lines, part_rows, walls_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TEMPERATURES = (5.0, 15.0, 25.0, 35.0, 45.0)
"""[deg C]"""
SIZES = ((3, 1), (4, 2), (5, 2), (5, 3), (6, 2), (6, 3), (8, 3), (10, 3))
"""Diameter and thickness of discs that many sellers stock [mm]."""
_GRADE_COLUMNS = ("grade", "remanence [T]", "frequency [%]", "damping ratio [%]")
_BLANK = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}


def workshop_sheet(
    scene: Scene,
    rest: float,
    find_bed: Callable[[], Equilibrium],
    *,
    amplitude: float,
    title: str,
    lead: str,
    scatter: Sequence[str],
    notes: Sequence[str] = (),
) -> Page:
    """Page to build a damper from, for a screen or for paper; rest, amplitude of use [m].

    A bed that has no equilibrium nearby is a note on the page.
    """
    costs: Tolerances | None = None
    gaps: list[tuple[str, ...]] = []
    limits = ["The bed has no oscillation about an equilibrium, so its limits are not known."]
    try:
        bed = find_bed()
        root = piston_roots(bed)[0]
        gaps, limits = gap_rows(bed, root, amplitude), limit_lines(bed, root, amplitude)
        costs = usual_tolerances(bed, amplitude)
    except InputError as error:
        notes = [*notes, f"{error}"]
    blocks = [
        *cautions(notes),
        *_parts(scene, rest),
        *_liquid_and_gap(scene, amplitude, gaps),
        Heading("Limits of use"),
        Items(limits),
        *_temperature(),
        Heading("Discs to buy"),
        Text(_disc_sizes_text(scene)),
        Table(_GRADE_COLUMNS, _grade_rows(scene, costs)),
        *(() if costs is None else tolerance_blocks(costs)),
        Heading("Scatter"),
        Items(scatter),
        *_first_measurements(scene),
    ]
    return Page(title, lead, blocks)


def _parts(scene: Scene, rest: float) -> Iterator[Block]:
    yield Picture(
        partial(_draw_cell, scene, rest),
        "Front view, all lengths in proportion, in mm. The piston is drawn at rest on discs in a "
        "lattice, the cell up to the height from which the piston is lowered.",
    )
    yield Heading("Parts")
    yield Table(("part", "number", "dimensions", "mass"), part_rows(scene, rest))
    yield Text(walls_text(scene))
    walls = scene.effects.walls
    laws = set() if walls is None else {wall.law for _, wall in walls.present_walls} - {"discs"}
    if laws:
        yield Caution(
            f"Walls were simulated by the law {', '.join(sorted(laws))}, not by these rows of magnets, which "
            "lower rest of the packaged damper by about 1 % and its frequency by 3 to 4 %. Design with "
            "magnets='cylinders' to have them in the simulations."
        )


def _liquid_and_gap(scene: Scene, amplitude: float, gaps: Sequence[tuple[str, ...]]) -> Iterator[Block]:
    yield Heading("Liquid and gap")
    drag = scene.effects.drag
    liquid = "The damper has no drag, so no liquid."
    if drag is not None and drag.coefficient:
        liquid = (
            f"A disc needs a drag of {drag.coefficient:.3g} kg/s: 2 eta A/h of a liquid of the viscosity eta "
            "in gaps h between its faces A and the plates, without flow back between discs."
        )
    yield Text(
        f"{liquid} Take the narrowest gap into which every disc fits, sorted by thickness: in the play discs "
        "tilt and bear on both plates, with a load that grows as the play (upper bound). Friction is a "
        "damping ratio added to that of the drag at an amplitude of "
        f"{1e3 * amplitude:.3g} mm, with static coefficients of metal on PTFE unless the scene names its "
        "own; if the bed sticks, a run decides."
        f"{'' if scene.effects.friction else ' The simulations had no friction on the plates.'}"
    )
    yield Table(GAP_COLUMNS, gaps)


def _temperature() -> Iterator[Block]:
    yield Heading("Temperature")
    yield Text(
        "Over their values at 25 °C: the viscosity of silicone oil, and so the drag (Shin-Etsu, Silicone "
        "Fluid KF-96, Performance Test Results), and the remanence of NdFeB (-0.12 %/K, shanghaimagnet.com)."
    )
    yield Table(
        ("temperature [°C]", "drag", "remanence"),
        [
            (
                f"{value:g}",
                format_number(silicone_oil_viscosity_ratio(value), 3),
                format_number(1.0 + REMANENCE_SLOPE * (value - 25.0), 3),
            )
            for value in TEMPERATURES
        ],
    )


def _first_measurements(scene: Scene) -> Iterator[Block]:
    yield Heading("What to measure first")
    yield Text(
        "First weigh the piston with all that moves with it. Rest and frequency know the discs' moment m "
        "and the mass M only as m²/M: with M weighed, the height at rest gives the moment. Measure it with "
        "two or more weighed masses, so that a wrong zero of the scale shows. Then, the machine held still, "
        "lift the piston by a fifth of a disc's diameter, release it and record its height for three "
        "seconds, at 200 samples a second or more, as a table of time and height. Read back remanence and "
        "drag, with the mass as weighed, and simulate again:"
    )
    host = " --set effects.host=none" if scene.effects.host else ""  # it is held still
    yield Printout(
        "granular-damper calibrate lab.csv scene.toml --set 'piston.mass=WEIGHED kg' \\\n"
        "    --parameter effects.drag.coefficient --parameter grains.remanence -o out/read-back" + host
    )


def usual_tolerances(bed: Equilibrium, amplitude: float) -> Tolerances:
    """Usual tolerances of a bed's parts, with dry friction at an amplitude [m] if there is any."""
    parts = read_parts(bed.scene, usual_parts(bed.scene))
    return tolerances_at([bed], parts, amplitude=amplitude if names_friction(bed.scene) else None, draws=0)


def _disc_sizes_text(scene: Scene) -> str:
    """Sizes that are sold, and a remark if those of the scene are not among them."""
    grains = scene.grains
    own = [
        (round(1e3 * species.diameter, 3), round(1e3 * float(thickness), 3))
        for species, thickness in zip(grains.species, grains.species_values("thickness"), strict=True)
    ]
    odd = [f"{d:g} x {h:g}" for d, h in own if (d, h) not in SIZES]
    fits = f"; {' and '.join(odd)} is none of them, so have it made" if odd else ""
    sizes = ", ".join(f"{d} x {h}" for d, h in SIZES)
    return (
        f"Usual sizes, diameter x thickness in mm, each within 0.1: {sizes}{fits}. Grades "
        "(shanghaimagnet.com), and the change that the middle of each makes in this damper, by its slope:"
    )


def _grade_rows(scene: Scene, costs: Tolerances | None) -> list[tuple[str, ...]]:
    """Each grade with its remanence [T], and the changes [%] that it makes in this damper."""
    own = float(scene.grains.species_values("remanence")[0])
    slopes = {} if costs is None else dict(zip((p.key for p in costs.parts), costs.slopes[0], strict=True))
    rows = []
    for name, grade in GRADES.items():
        if not name[-1].isdigit():
            continue  # the same remanence, for higher temperatures
        ratio = grade.remanence / own
        changes = [f"{100.0 * (ratio**s - 1.0):+.1f}" for s in slopes.get("grains.remanence", ())[1:]]
        rows.append((name, f"{grade.lowest:.2f} to {grade.highest:.2f}", *(changes or ["", ""])))
    return rows


def _draw_cell(scene: Scene, rest: float) -> Figure:
    """Front view of cell, bed and piston, with dimensions [mm]."""
    from matplotlib.patches import Circle, Rectangle

    assert scene.piston is not None
    width, height, level = (1e3 * x for x in (scene.cell.width, scene.piston.height, rest))
    diameters, plate = 1e3 * scene.grains.diameters(), 0.03 * width
    with figure(width=7.2, height=7.2 * (height + 8 * plate) / (1.35 * width)) as (drawing, axes):
        for corner, size in (
            ((-plate, -plate), (plate, height + plate)),
            ((width, -plate), (plate, height + plate)),
            ((0.0, -plate), (width, plate)),
        ):
            axes.add_patch(Rectangle(corner, *size, color=GREY))
        axes.add_patch(Rectangle((0.0, level), width, 2.0 * plate, fill=False, hatch="//"))
        for x, y, size in zip(*_lattice(len(diameters), width, level), diameters, strict=True):
            axes.add_patch(Circle((x, y), 0.5 * size, fill=False, color=COLOURS[0], linewidth=0.6))
        for start, end, text in (
            ((0.0, -2.2 * plate), (width, -2.2 * plate), f"{width:.4g}"),
            ((width + 2.2 * plate, 0.0), (width + 2.2 * plate, level), f"{level:.4g}"),
            ((-2.4 * plate, 0.0), (-2.4 * plate, height), f"{height:.4g}"),
        ):
            axes.annotate("", start, end, arrowprops={"arrowstyle": "<->", "linewidth": 0.8})
            middle, turned = 0.5 * np.add(start, end), 90 if start[0] == end[0] else 0
            axes.text(*middle, text, ha="center", va="center", rotation=turned, bbox=_BLANK)
        of_piston = f"piston, {scene.piston.mass:.4g} kg"
        of_discs = f"{len(diameters)} discs, the first of {1e3 * scene.grains.species[0].diameter:g} mm"
        axes.text(0.5 * width, level + plate, of_piston, ha="center", va="center", bbox=_BLANK)
        axes.text(0.5 * width, height, of_discs, ha="center", va="top")
        axes.set(xlim=(-6 * plate, width + 6 * plate), ylim=(-4.5 * plate, height + 2 * plate))
        axes.set_aspect("equal")
        axes.axis("off")
        return drawing


def _lattice(count: int, width: float, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Sites of a hexagonal lattice that fills a cell up to the level."""
    across = max(round(math.sqrt(width * count * math.sqrt(0.75) / level)), 1)
    row, column = np.divmod(np.arange(count), across)
    return (column + 0.25 + 0.5 * (row % 2)) * width / across, (row + 0.5) * level / math.ceil(count / across)
