"""Parts of a damper, the gaps between its plates and the limits of its use, from its settled bed."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from granular.linear.friction import motion_friction
from granular.parts.grades import GRADES, Grade
from granular.parts.liquids import find_liquid
from granular.parts.plates import bow_of_plate
from granular.schema.natural_units import Scales
from granular.shared.blocks import format_number

if TYPE_CHECKING:
    from granular.linear.equilibrium import Equilibrium
    from granular.linear.roots import Root
    from granular.scene.scene import Scene

PartRow = tuple[str, str, str, str]
"""Part, number, dimensions, mass."""
GAPS = (5e-5, 1e-4, 2e-4, 5e-4)
"""Between a face of a grain and its plate [m]."""
_SIDES = {"top": "piston", "bottom": "floor"}
COEFFICIENTS = (0.05, 0.1)
"""Static coefficients of friction, of metal on PTFE: 0.05 to 0.1."""
LEAVES = 0.05
"""Part of the repulsion that two discs may lose on opposite plates: 7.5 p^2/r^2 at the play p, of an energy
(1 - 4.5 p^2/r^2)/r^3."""
GLASS = (4, 5, 6, 8, 10, 12, 15, 19, 25)
"""Thicknesses of float glass (EN 572-2) [mm]."""
BOWS = 0.25
"""Part of the play that plates may bow by: the load grows with the play."""
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
    """All parts of a scene; height at rest [m]."""
    return [*_disc_rows(scene), *_wall_rows(scene), *_piston_rows(scene), *_cell_rows(scene, rest)]


def _disc_rows(scene: Scene) -> Iterator[PartRow]:
    grains = scene.grains
    masses, kinds = grains.masses(), grains.species_indices()
    law = "point dipoles" if grains.magnets == "dipoles" else "discs"
    for k, species in enumerate(grains.species):
        own = masses[kinds == k]
        thickness, remanence = (float(grains.species_values(name)[k]) for name in ("thickness", "remanence"))
        grade = "".join(f" ({grade.name})" for grade in _grades_of(remanence)[:1])
        words = (
            f"diameter {1e3 * species.diameter:g} mm, thickness {1e3 * thickness:g} mm, "
            f"remanence {remanence:g} T{grade}"
        )
        if grains.coating is not None:
            words += f", {1e6 * grains.coating:g} um of it coating"
        if grains.permeability is not None:
            words += f", permeability {grains.permeability:g}"
        if grains.temperature is not None:
            words += f", at {grains.temperature:g} °C"
        yield (
            "disc magnet, magnetised along its axis",
            str(len(own)),
            f"{words}; simulated as {law}, moment {grains.magnets_in_species()[k].moment:.5g} A m^2",
            f"{1e3 * own[0]:.4g} g each, {own.sum():.4g} kg in all",
        )


def _wall_rows(scene: Scene) -> Iterator[PartRow]:
    """Rows of magnets by which piston, floor and sides repel."""
    walls, piston = scene.effects.walls, scene.piston
    assert piston is not None
    diameter = scene.grains.species[0].diameter
    for side, wall in () if walls is None else walls.present_walls:
        pitch = wall.pitch or diameter
        length = scene.cell.width if side in ("top", "bottom") else piston.height
        law = "as simulated" if wall.law == "discs" else f"simulated by the law {wall.law}"
        yield (
            f"disc magnets of the {_SIDES.get(side, side + ' side')}",
            str(math.floor(length / pitch + 0.5)),
            f"like the first grains, a row of pitch {1e3 * pitch:g} mm, middles {0.5e3 * diameter:g} mm "
            f"behind the face; {law}",
            "",
        )


def walls_text(scene: Scene) -> str:
    """Hold of the walls' magnets."""
    # Dipoles at one diameter; discs push more.
    push = 0.75 * Scales.from_grains(scene.grains).force
    return (
        "Magnets of walls and piston have their poles the same way as the grains. Glue them into grooves of "
        "a material that is not magnetic, closed at both ends: neighbours that touch push each other apart "
        f"with {push:.2g} N or more."
    )


def _piston_rows(scene: Scene) -> Iterator[PartRow]:
    piston, drag = scene.piston, scene.effects.drag
    assert piston is not None
    yield (
        "piston, as wide as the cell",
        "1",
        f"width {1e3 * scene.cell.width:.4g} mm, drag {piston.drag:.4g} kg/s, friction {piston.friction:g} N",
        f"{piston.mass or 0.0:.5g} kg with all that moves with it",
    )
    if piston.blade is not None:
        size = f"{1e3 * piston.blade.depth:g} mm deep, films of {1e3 * piston.blade.film:g} mm"
        yield ("blade of the piston, in the liquid", "1", size, "")
    if piston.guide is not None:
        guide = piston.guide
        size = f"diameter {1e3 * guide.diameter:g} mm, {1e3 * guide.length:g} mm long"
        yield ("rod and bush", str(guide.count), f"{size}, clearance {1e6 * guide.clearance:g} um", "")
    if drag is None:
        return
    if drag.liquid is None:
        yield ("liquid", "1", f"drag of a disc {drag.coefficient:.5g} kg/s, in a gap of the table below", "")
    else:
        celsius = scene.grains.liquid_temperature
        oil = find_liquid(drag.liquid, celsius)
        words = f"{oil.viscosity:.4g} Pa s at {celsius:g} °C, {oil.density:.4g} kg/m^3"
        yield (drag.liquid, "1", f"{words}, as sold within {100.0 * oil.uncertainty:g} %", "")


def _cell_rows(scene: Scene, rest: float) -> Iterator[PartRow]:
    assert scene.piston is not None
    drag, gap = scene.effects.drag, ""
    if drag is not None and drag.follows:
        gap = f", {1e3 * scene.cell.separation:g} mm apart"
    yield (
        "plates of a material that is not magnetic",
        "2",
        f"inner width {1e3 * scene.cell.width:.4g} mm, height {1e3 * scene.piston.height:.4g} mm or more "
        f"(at rest {1e3 * rest:.4g} mm){gap}",
        "",
    )


def _grades_of(remanence: float) -> list[Grade]:
    return [grade for grade in GRADES.values() if grade.lowest <= remanence <= grade.highest]


def gap_rows(bed: Equilibrium, root: Root, amplitude: float) -> list[tuple[str, ...]]:
    """Gaps at which the bed stays in its plane, with what they cost at an amplitude [m]."""
    from scipy.spatial.distance import pdist

    scene, drag = bed.scene, bed.scene.effects.drag
    thickness = float(scene.grains.species_values("thickness").max())
    diameter = scene.grains.species[0].diameter
    nearest = pdist(bed.positions).min()
    follows = drag is not None and drag.follows
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
        # That gives the first discs their drag.
        viscosity = (
            0.0 if drag is None else drag.viscosity or 2.0 * drag.coefficient * film / math.pi / diameter**2
        )
        plates = _plates_text(rubs.load, scene.cell.width, bed.piston_height or 0.0, play)
        plates += f"; discs on opposite plates repel by {100.0 * lost:.2g} % less"
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


def _plates_text(load: float, width: float, height: float, play: float) -> str:
    """Thinnest glass that bows by no more than a part of the play under a load [N]; lengths [m]."""
    for thick in GLASS:
        bow, enough = bow_of_plate(load, width, height, 1e-3 * thick), ""
        if bow.supported <= BOWS * play:
            break
        enough = ", too much: hold them by ribs"
    size = f"{1e3 * bow.clamped:.2g} to {1e3 * bow.supported:.2g} mm"
    return f"glass of {thick} mm bows by {size} under {load:.3g} N{enough}"


def limit_lines(bed: Equilibrium, root: Root, amplitude: float) -> list[str]:
    """Limits of use: touching discs, temperature, and energy a cycle at an amplitude [m]."""
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
        f"The first discs touch {1e3 * (1.0 - factor) * bed.piston_height:.3g} mm below rest, if they follow "
        f"the piston evenly; {load:.3g} N on the piston hold it there, {pencil.bed.weight:.3g} N at rest.",
        f"A cycle of {1e3 * amplitude:.3g} mm takes {energy:.2g} J by drag, {energy * root.frequency:.2g} W.",
    ]
    grades = _grades_of(float(scene.grains.species_values("remanence")[0]))
    named = GRADES.get(scene.grains.grade or "", grades[0] if grades else None)
    if named is not None:
        lines.append(
            f"{named.name} loses moment for good above {named.highest_temperature:g} °C, and from less on as "
            "discs flatter than 0.7 times their diameter."
        )
    return lines
