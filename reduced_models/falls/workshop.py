"""The workshop sheet for building a damper: parts, effects of their tolerances, first measurements.

The effects of tolerances are computed for the settled bed.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from granular.linear import piston_roots
from granular.linear.equilibrium import Equilibrium
from granular.linear.friction import has_friction, motion_friction
from granular.parts.liquids import bow_of_plate, find_liquid, silicone_oil_viscosity_ratio
from granular.parts.magnets import GRADES, REMANENCE_SLOPE, Grade
from granular.scene.scene import Scene
from granular.schema.natural_units import Scales
from granular.shared.blocks import (
    Block,
    Caution,
    Heading,
    Items,
    Picture,
    Printout,
    Table,
    Text,
    format_number,
    make_cautions,
)
from granular.shared.errors import InputError
from granular.shared.html_pages import Page
from granular.shared.plotting import COLOURS, GREY, figure
from granular.studies.study_page import tolerance_blocks
from granular.studies.tolerances import Tolerances, read_part_tolerances, tolerances_at, usual_parts

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from granular.linear.roots import Root


PartRow = tuple[str, str, str, str]
"""Row of the table of parts: part, number, dimensions, mass."""
GAPS = (5e-5, 1e-4, 2e-4, 5e-4)
"""Gaps [m] between a face of a grain and the plate, for the table of gaps."""
_SIDES = {"top": "piston", "bottom": "floor"}
COEFFICIENTS = (0.05, 0.1)
"""Static friction coefficients of metal on PTFE: 0.05 to 0.1."""
LEAVES = 0.05
"""Maximum relative loss of repulsion between two discs that touch opposite plates. If discs have the play p
between the plates, the loss at distance r is 7.5 p^2/r^2, since the energy is proportional to
(1 - 4.5 p^2/r^2)/r^3."""
GLASS = (4, 5, 6, 8, 10, 12, 15, 19, 25)
"""Thicknesses of float glass (EN 572-2) [mm]."""
BOWS = 0.25
"""Maximum bow (deflection) of the plates, divided by the play of the discs between the plates."""
GAP_COLUMNS = (
    "gap on each side [mm]",
    "depth of the cell [mm]",
    "viscosity [Pa s]",
    "tilt [°]",
    "load of a disc [N]",
    "friction",
    "plates",
)


def part_rows(scene: Scene, rest: float) -> list[PartRow]:
    """List all parts of a scene; ``rest`` is the equilibrium height [m]."""
    return [
        *_disc_part_rows(scene),
        *_wall_magnet_rows(scene),
        *_piston_part_rows(scene),
        *_cell_part_rows(scene, rest),
    ]


def _disc_part_rows(scene: Scene) -> Iterator[PartRow]:
    grains = scene.grains
    masses, kinds = grains.masses(), grains.species_indices()
    law = "point dipoles" if grains.magnets == "dipoles" else "discs"
    for k, species in enumerate(grains.species):
        own = masses[kinds == k]
        thickness, remanence = (float(grains.species_values(name)[k]) for name in ("thickness", "remanence"))
        grade = "".join(f" ({grade.name})" for grade in _magnet_grades_of_remanence(remanence)[:1])
        words = (
            f"diameter {1e3 * species.diameter:g} mm, thickness {1e3 * thickness:g} mm, "
            f"remanence {remanence:g} T{grade}"
        )
        if grains.coating is not None:
            words += f", including {1e6 * grains.coating:g} um of coating"
        if grains.permeability is not None:
            words += f", permeability {grains.permeability:g}"
        if grains.temperature is not None:
            words += f", at {grains.temperature:g} °C"
        yield (
            "disc magnet, magnetised along its axis",
            str(len(own)),
            f"{words}; simulated as {law}, moment {grains.magnets_in_species()[k].moment:.5g} A m^2",
            f"{1e3 * own[0]:.4g} g each, {own.sum():.4g} kg in total",
        )


def _wall_magnet_rows(scene: Scene) -> Iterator[PartRow]:
    """List the rows of magnets in piston, floor and sides."""
    walls, piston = scene.effects.walls, scene.piston
    assert piston is not None
    diameter = scene.grains.species[0].diameter
    for side, wall in () if walls is None else walls.sides_with_walls:
        pitch = wall.pitch or diameter
        length = scene.cell.width if side in ("top", "bottom") else piston.height
        law = "as simulated" if wall.law == "discs" else f"simulated by the law {wall.law}"
        yield (
            f"disc magnets of the {_SIDES.get(side, side + ' side')}",
            str(math.floor(length / pitch + 0.5)),
            f"like the first grains, in a row of pitch {1e3 * pitch:g} mm with centres {0.5e3 * diameter:g} "
            f"mm behind the face; {law}",
            "",
        )


def wall_mounting_text(scene: Scene) -> str:
    """Explain how to mount the magnets of the walls."""
    # The force is for dipoles at one diameter; discs repel more strongly.
    push = 0.75 * Scales.from_grains(scene.grains).force
    return (
        "Magnets of walls and piston have the same orientation of poles as the grains. Glue them into "
        "grooves that are closed at both ends, in a non-magnetic material: touching neighbours repel each "
        f"other with {push:.2g} N or more."
    )


def _piston_part_rows(scene: Scene) -> Iterator[PartRow]:
    piston, drag = scene.piston, scene.effects.drag
    assert piston is not None
    yield (
        "piston, as wide as the cell",
        "1",
        f"width {1e3 * scene.cell.width:.4g} mm, drag {piston.drag:.4g} kg/s, friction {piston.friction:g} N",
        f"{piston.mass or 0.0:.5g} kg including all parts that move with it",
    )
    if piston.blade is not None:
        size = f"{1e3 * piston.blade.depth:g} mm deep, liquid films of {1e3 * piston.blade.film:g} mm"
        yield ("blade of the piston, in the liquid", "1", size, "")
    if piston.guide is not None:
        guide = piston.guide
        size = f"diameter {1e3 * guide.diameter:g} mm, {1e3 * guide.length:g} mm long"
        yield ("rod and bush", str(guide.count), f"{size}, clearance {1e6 * guide.clearance:g} um", "")
    if drag is None:
        return
    if drag.liquid is None:
        yield ("liquid", "1", f"drag of a disc {drag.coefficient:.5g} kg/s; for gaps see the table below", "")
    else:
        celsius = scene.grains.liquid_temperature
        oil = find_liquid(drag.liquid, celsius)
        words = f"{oil.viscosity:.4g} Pa s at {celsius:g} °C, {oil.density:.4g} kg/m^3"
        yield (drag.liquid, "1", f"{words}; viscosity as sold within {100.0 * oil.uncertainty:g} %", "")


def _cell_part_rows(scene: Scene, rest: float) -> Iterator[PartRow]:
    assert scene.piston is not None
    drag, gap = scene.effects.drag, ""
    if drag is not None and drag.is_from_liquid:
        gap = f", {1e3 * scene.cell.separation:g} mm apart"
    yield (
        "plates of a non-magnetic material",
        "2",
        f"inner width {1e3 * scene.cell.width:.4g} mm, height {1e3 * scene.piston.height:.4g} mm or more "
        f"(piston at rest: {1e3 * rest:.4g} mm){gap}",
        "",
    )


def _magnet_grades_of_remanence(remanence: float) -> list[Grade]:
    return [grade for grade in GRADES.values() if grade.lowest <= remanence <= grade.highest]


def gap_effect_rows(bed: Equilibrium, root: Root, amplitude: float) -> list[tuple[str, ...]]:
    """List gaps between discs and plates with their effects at an amplitude [m], as rows of a table."""
    from scipy.spatial.distance import pdist

    scene, drag = bed.scene, bed.scene.effects.drag
    thickness = float(scene.grains.species_values("thickness").max())
    diameter = scene.grains.species[0].diameter
    nearest = pdist(bed.positions).min()
    follows = drag is not None and drag.is_from_liquid
    rows: list[tuple[str, ...]] = []
    for film in (0.5 * (scene.cell.separation - thickness),) if follows else GAPS:
        depth, play = thickness + 2.0 * film, 2.0 * film
        lost = 7.5 * (play / nearest) ** 2
        if lost > LEAVES and not follows:
            continue
        wide = dataclasses.replace(bed, scene=scene.replace(**{"cell.separation": depth}))
        named = scene.effects.friction is not None
        words = []
        for static in (None,) if named else COEFFICIENTS:
            rubs = motion_friction(wide, static, root)
            added, sticking = rubs.equivalent_damping_ratio(amplitude), rubs.sticking_amplitude
            doubles = ", doubles the damping" if added > root.damping_ratio else ""
            sticks = "sticks" if amplitude < sticking else f"+{100.0 * added:.2g} %"
            name = "" if static is None else f"mu {static:g}: "
            words.append(f"{name}{sticks}{doubles}; sticks below {1e3 * sticking:.2g} mm")
        tilt = math.asin(depth / math.hypot(diameter, thickness)) - math.atan(thickness / diameter)
        # The viscosity that gives the first discs their drag.
        viscosity = (
            0.0 if drag is None else drag.viscosity or 2.0 * drag.coefficient * film / math.pi / diameter**2
        )
        plates = _glass_thickness_text(rubs.load, scene.cell.width, bed.piston_height or 0.0, play)
        plates += f"; repulsion of discs on opposite plates is {100.0 * lost:.2g} % smaller"
        rows.append(
            (
                f"{1e3 * film:.4g}",
                format_number(1e3 * depth),
                format_number(viscosity, 3),
                f"{math.degrees(tilt):.2g}",
                f"{rubs.load / scene.grains.count:.2g}",
                ". ".join(words),
                plates,
            )
        )
    return rows


def _glass_thickness_text(load: float, width: float, height: float, play: float) -> str:
    """Describe the thinnest glass whose bow is small relative to the play; load in N, lengths in m."""
    for thick in GLASS:
        bow, enough = bow_of_plate(load, width, height, 1e-3 * thick), ""
        if bow.supported <= BOWS * play:
            break
        enough = ", too much: support the plates by ribs"
    size = f"{1e3 * bow.clamped:.2g} to {1e3 * bow.supported:.2g} mm"
    return f"glass of {thick} mm bows by {size} under {load:.3g} N{enough}"


def limits_of_use_lines(bed: Equilibrium, root: Root, amplitude: float) -> list[str]:
    """State the limits of use: touching discs, temperature, and energy per cycle at an amplitude [m]."""
    scene, pencil, radii = bed.scene, bed.pencil, 0.5 * bed.scene.grains.diameters()
    assert bed.piston_height is not None
    assert scene.piston is not None
    i, j = np.triu_indices(len(radii), 1)
    touch, (across, height) = radii[i] + radii[j], np.abs(bed.positions[i] - bed.positions[j]).T
    near = across < touch
    factors = np.sqrt(touch[near] ** 2 - across[near] ** 2) / height[near]
    factor = float(min(factors.max(initial=0.0), 1.0))
    squeezed = pencil.at.copy()
    squeezed[pencil.bed.grains : pencil.bed.bodies] *= factor
    load = pencil.bed.forces(squeezed)[pencil.bed.piston] + pencil.bed.weight
    speed = math.tau * root.frequency * amplitude
    energy = math.tau * root.damping_ratio * (scene.piston.mass or 0.0) * speed**2
    lines = [
        "If the bed follows the piston affinely, the first discs touch "
        f"{1e3 * (1.0 - factor) * bed.piston_height:.3g} mm below rest; this needs a load of {load:.3g} N on "
        f"the piston, compared with {pencil.bed.weight:.3g} N at rest.",
        f"A cycle of amplitude {1e3 * amplitude:.3g} mm dissipates {energy:.2g} J by drag, on average "
        f"{energy * root.frequency:.2g} W.",
    ]
    grades = _magnet_grades_of_remanence(float(scene.grains.species_values("remanence")[0]))
    named = GRADES.get(scene.grains.grade or "", grades[0] if grades else None)
    if named is not None:
        lines.append(
            f"{named.name} loses moment permanently above {named.highest_temperature:g} °C, and at lower "
            "temperatures for discs thinner than 0.7 times their diameter."
        )
    return lines


TEMPERATURES = (5.0, 15.0, 25.0, 35.0, 45.0)
"""Temperatures [deg C] in the table of the effects of temperature."""
SIZES = ((3, 1), (4, 2), (5, 2), (5, 3), (6, 2), (6, 3), (8, 3), (10, 3))
"""Diameter and thickness of commonly available discs [mm]."""
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
    """Make a page with instructions for building a damper, for screen or print.

    The equilibrium height ``rest`` and the ``amplitude`` in use are in m. If the bed has no equilibrium
    nearby, a note on the page says so.
    """
    costs: Tolerances | None = None
    gaps: list[tuple[str, ...]] = []
    limits = ["The bed has no oscillation about an equilibrium, so its limits are not known."]
    try:
        bed = find_bed()
        root = piston_roots(bed)[0]
        gaps, limits = gap_effect_rows(bed, root, amplitude), limits_of_use_lines(bed, root, amplitude)
        costs = usual_tolerances(bed, amplitude)
    except InputError as error:
        notes = [*notes, f"{error}"]
    blocks = [
        *make_cautions(notes),
        *_parts_section(scene, rest),
        *_liquid_and_gap_section(scene, amplitude, gaps),
        Heading("Limits of use"),
        Items(limits),
        *_temperature_section(),
        Heading("Discs to buy"),
        Text(_disc_sizes_text(scene)),
        Table(_GRADE_COLUMNS, _grade_rows(scene, costs)),
        *(() if costs is None else tolerance_blocks(costs)),
        Heading("Scatter"),
        Items(scatter),
        *_first_measurements_section(scene),
    ]
    return Page(title, lead, blocks)


def _parts_section(scene: Scene, rest: float) -> Iterator[Block]:
    yield Picture(
        partial(_draw_cell, scene, rest),
        "Front view to scale, lengths in mm. The piston is drawn at equilibrium on a regular lattice of "
        "discs; the cell is drawn up to the height from which the piston is lowered.",
    )
    yield Heading("Parts")
    yield Table(("part", "number", "dimensions", "mass"), part_rows(scene, rest))
    yield Text(wall_mounting_text(scene))
    walls = scene.effects.walls
    laws = set() if walls is None else {wall.law for _, wall in walls.sides_with_walls} - {"discs"}
    if laws:
        yield Caution(
            f"The simulations used the wall law {', '.join(sorted(laws))} in place of these rows of magnets. "
            "For the packaged damper, the rows lower the equilibrium by about 1 % and the frequency by 3 to "
            "4 %. To include the rows in the simulations, design with magnets='cylinders'."
        )


def _liquid_and_gap_section(
    scene: Scene, amplitude: float, gaps: Sequence[tuple[str, ...]]
) -> Iterator[Block]:
    yield Heading("Liquid and gap")
    drag = scene.effects.drag
    liquid = "The damper has no drag and needs no liquid."
    if drag is not None and drag.coefficient:
        liquid = (
            f"Each disc needs a drag coefficient of {drag.coefficient:.3g} kg/s. A liquid of viscosity eta "
            "in gaps of width h between the plates and the disc's faces of area A gives 2 eta A/h, without "
            "backflow between discs."
        )
    yield Text(
        f"{liquid} Sort the discs by thickness and use the narrowest gap into which every disc fits. In this "
        "gap, discs tilt and press on both plates; the load in the table is an upper bound, proportional to "
        "the play. Friction is given as an additional damping ratio at an amplitude of "
        f"{1e3 * amplitude:.3g} mm, with the static coefficients of the scene or, by default, of metal on "
        "PTFE. If the bed sticks, simulate "
        f"it.{'' if scene.effects.friction else ' The simulations had no friction on the plates.'}"
    )
    yield Table(GAP_COLUMNS, gaps)


def _temperature_section() -> Iterator[Block]:
    yield Heading("Temperature")
    yield Text(
        "Drag and remanence relative to their values at 25 °C. The drag is proportional to the viscosity of "
        "silicone oil (Shin-Etsu, Silicone Fluid KF-96, Performance Test Results); the remanence of NdFeB "
        "changes by -0.12 %/K (shanghaimagnet.com)."
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


def _first_measurements_section(scene: Scene) -> Iterator[Block]:
    yield Heading("First measurements")
    yield Text(
        "First weigh the piston with all parts that move with it. Equilibrium and frequency depend on the "
        "discs' moment m and the mass M only through m²/M. If M is weighed, the equilibrium height gives "
        "the moment. Measure this height with two or more weighed masses, since different moments show that "
        "the zero of the height is wrong. Then hold "
        "the machine still, lift the piston by a fifth of a disc's diameter, release it and record its "
        "height for three seconds, at 200 samples per second or more, as a table of time and height. "
        "Determine remanence and drag with the weighed mass, and simulate again:"
    )
    host = " --set effects.host=none" if scene.effects.host else ""  # the machine is held still
    yield Printout(
        "granular-damper calibrate lab.csv scene.toml --set 'piston.mass=WEIGHED kg' \\\n"
        "    --parameter effects.drag.coefficient --parameter grains.remanence -o out/read-back" + host
    )


def usual_tolerances(bed: Equilibrium, amplitude: float) -> Tolerances:
    """Return typical tolerances of a bed's parts; dry friction, if any, is taken at an amplitude [m]."""
    parts = read_part_tolerances(bed.scene, usual_parts(bed.scene))
    return tolerances_at([bed], parts, amplitude=amplitude if has_friction(bed.scene) else None, draws=0)


def _disc_sizes_text(scene: Scene) -> str:
    """List available sizes of discs, and state which sizes of the scene are not available."""
    grains = scene.grains
    own = [
        (round(1e3 * species.diameter, 3), round(1e3 * float(thickness), 3))
        for species, thickness in zip(grains.species, grains.species_values("thickness"), strict=True)
    ]
    odd = [f"{d:g} x {h:g}" for d, h in own if (d, h) not in SIZES]
    fits = f"; {' and '.join(odd)} is not available and must be custom-made" if odd else ""
    sizes = ", ".join(f"{d} x {h}" for d, h in SIZES)
    return (
        f"Common sizes (diameter x thickness in mm, each within 0.1 mm): {sizes}{fits}. The table lists "
        "grades (shanghaimagnet.com). Changes of this damper are for the middle remanence of each grade, "
        "computed from first derivatives:"
    )


def _grade_rows(scene: Scene, costs: Tolerances | None) -> list[tuple[str, ...]]:
    """List grades with their remanence [T], and the resulting changes [%] of this damper."""
    own = float(scene.grains.species_values("remanence")[0])
    slopes = {} if costs is None else dict(zip((p.key for p in costs.parts), costs.slopes[0], strict=True))
    rows = []
    for name, grade in GRADES.items():
        if not name[-1].isdigit():
            continue  # same remanence, for higher temperatures
        ratio = grade.remanence / own
        changes = [f"{100.0 * (ratio**s - 1.0):+.1f}" for s in slopes.get("grains.remanence", ())[1:]]
        rows.append((name, f"{grade.lowest:.2f} to {grade.highest:.2f}", *(changes or ["", ""])))
    return rows


def _draw_cell(scene: Scene, rest: float) -> Figure:
    """Draw the front view of cell, bed and piston, with dimensions [mm]."""
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
        for x, y, size in zip(*_lattice_sites(len(diameters), width, level), diameters, strict=True):
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


def _lattice_sites(count: int, width: float, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the sites of a hexagonal lattice that fills a cell up to a height."""
    across = max(round(math.sqrt(width * count * math.sqrt(0.75) / level)), 1)
    row, column = np.divmod(np.arange(count), across)
    return (column + 0.25 + 0.5 * (row % 2)) * width / across, (row + 0.5) * level / math.ceil(count / across)
