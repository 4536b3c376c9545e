"""The LAMMPS input script of a scene as text, and the tables of pair and wall laws, in SI."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from granular.effects.dipole import discs_unless_dipoles
from granular.effects.wall_laws import ExperimentalWall, InfiniteWall
from granular.export.lammps_stages import RemainingStage
from granular.pairs import dipole_law
from granular.pairs.disc_law import disc_energy_and_force_continued_below_contact, force_slope_at_contact
from granular.scene.scene import Scene
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError

ROWS = 5000
"""Number of rows of a table, in geometric steps; LAMMPS interpolates them by a cubic spline, which is
accurate to 1e-9 of the force."""

NEAREST_PAIR, NEAREST_WALL = 0.25, 0.1
"""Shortest distances in the tables of pairs and walls, in diameters of the smallest species; LAMMPS stops if
a grain comes closer.
"""

MAXIMUM_WALL_DISTANCE = 200.0
"""Maximum distance in the walls' tables [D], at which the law "experimental" gives a force of 5e-9 F*."""

WALLS: dict[str, tuple[Any, float]] = {
    "experimental": (ExperimentalWall, 3.5),
    "infinite": (InfiniteWall, 3.0),
}
"""Wall laws that depend only on distance, each with the exponent of its force as a function of distance."""

_PAIR_EXPONENT = 4.0


def pair_table_lines(deck: LammpsDeck) -> Iterator[str]:
    """Yield the lines of the repulsion tables of all pairs of species, in m, J and N."""
    if deck.pair_cutoff is None:
        return
    r = np.geomspace(NEAREST_PAIR * math.sqrt(min(deck.moment_ratios)), deck.pair_cutoff, ROWS)
    discs = discs_unless_dipoles(deck.scene.grains, deck.scales.length)
    for first, second in deck.species_pairs():
        energy, force = dipole_law.ENERGY / r**3, dipole_law.STRENGTH / r**4
        slopes = -_PAIR_EXPONENT * force[[0, -1]] / r[[0, -1]]
        if discs:
            pair = discs[first - 1], discs[second - 1]
            energy, force = (
                dipole_law.ENERGY * part for part in disc_energy_and_force_continued_below_contact(r, pair)
            )
            slopes = np.array(
                [dipole_law.ENERGY * force_slope_at_contact(*pair), -_PAIR_EXPONENT * force[-1] / r[-1]]
            )
        product = deck.moment_ratios[first - 1] * deck.moment_ratios[second - 1]
        law = product * energy, product * force, product * slopes
        yield from _table_lines(pair_table_name(first, second), "FPRIME", deck.scales, r, *law)


def wall_table_lines(deck: LammpsDeck) -> Iterator[str]:
    """Yield the lines of the power-law repulsion tables of all walls and species, in m, J and N."""
    # LAMMPS reads one row beyond the last distance.
    w = np.geomspace(NEAREST_WALL * math.sqrt(min(deck.moment_ratios)), 1.001 * deck.wall_cutoff, ROWS)
    for law in dict.fromkeys(deck.wall_laws.values()):
        wall, exponent = WALLS[law]
        for number, moment_ratio in enumerate(deck.moment_ratios, start=1):
            force = moment_ratio * wall.force(None, 1.0) / w**exponent
            slopes = -exponent * force[[0, -1]] / w[[0, -1]]
            name, energy = wall_table_name(law, number), force * w / (exponent - 1.0)
            yield from _table_lines(name, "FP", deck.scales, w, energy, force, slopes)


def _table_lines(
    name: str,
    slope_keyword: str,
    scales: Scales,
    distance: np.ndarray,
    energy: np.ndarray,
    force: np.ndarray,
    slopes: np.ndarray,
) -> Iterator[str]:
    """Yield the lines of a table in SI, from a law and the force's slopes at both ends in natural units."""
    first, last = (slopes * (scales.force / scales.length)).tolist()
    yield f"{name}\nN {ROWS} {slope_keyword} {first:.17g} {last:.17g}\n\n"
    rows = np.column_stack([distance * scales.length, energy * scales.energy, force * scales.force])
    for number, row in enumerate(rows.tolist(), start=1):
        yield "{} {:.17g} {:.17g} {:.17g}\n".format(number, *row)
    yield "\n"


PAIR_BITS, WALL_ROWS = 16, 100_000
"""Sizes of LAMMPS's internal tables: for pairs 2^16 rows, spaced like floating-point numbers and interpolated
linearly; for walls 100,000 rows in equal steps, interpolated by splines."""

FACES = {"left": "xlo", "right": "xhi", "bottom": "ylo", "top": "yhi"}

OPEN_MARGIN = 2.0
"""Cut-off distance of pairs if a side of the cell is open, in units of the cell's diagonal."""


EXPORTED_EFFECTS = ("dipole", "walls", "gravity", "drag", "shaking")
"""Effects of a scene that can be exported to LAMMPS."""
_REASONS = {
    "friction": ": LAMMPS has no dry friction with sticking under a load that depends on magnetic forces",
    "contact": ": the dashpot of a contact does not depend on distance only",
}


def check_exportable_scene(scene: Scene) -> None:
    """Raise an error for a scene that a LAMMPS deck cannot represent."""
    effects, walls = scene.effects, scene.effects.walls
    if scene.grains.count == 0:
        raise InputError("grains.count = 0; LAMMPS needs 1 grain or more")
    for effect in effects.acting:
        if effect.key not in EXPORTED_EFFECTS:
            raise InputError(
                f"effects.{effect.key} cannot be exported to LAMMPS{_REASONS.get(effect.key, '')}; "
                f"remove it (--set effects.{effect.key}=none) or run the scene with this toolkit"
            )
    if scene.grains.spread > 0.0:
        raise InputError(
            "grains.spread cannot be exported to LAMMPS, whose tables are the same for all grains "
            "of a species; set it to 0"
        )
    if scene.cell.is_polygon:
        raise InputError(
            "cell.sides cannot be exported to LAMMPS, whose tabulated walls are vertical or "
            "horizontal; write the frames as extended XYZ, GSD or VTK, or describe the cell by cell.width"
        )
    for side, wall in () if walls is None else walls.sides_with_walls:
        if wall.law not in WALLS:
            reason = "it depends on two coordinates" if wall.own is None else "its law has no table"
            raise InputError(
                f"effects.walls.{side}.law = {wall.law!r} cannot be exported to LAMMPS: {reason}; use "
                f"{' or '.join(map(repr, WALLS))}"
            )
    if scene.cell.periods is not None:
        raise InputError(
            "cell.sides = 'periodic' cannot be exported to LAMMPS, since the exported script "
            "supports only walls; write the frames as extended XYZ, whose lattice is periodic"
        )
    if scene.pair_method == "verlet-list":
        raise InputError(
            "pairs.method = 'verlet-list' cannot be exported to LAMMPS, whose neighbour lists "
            "are always complete; use 'cut-off' with the same radius"
        )


class DeckStart(NamedTuple):
    """Initial state of a deck in SI, and the stages that the deck runs."""

    time: float
    height: float | None  # height of the piston; None without a piston
    grains: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    remaining_stages: tuple[RemainingStage, ...]


class LammpsDeck(NamedTuple):
    """Contents of the input script."""

    scene: Scene
    scales: Scales
    moment_ratios: tuple[float, ...]  # moment of each species relative to the first
    mass_ratios: tuple[float, ...]  # mass of each species relative to the first
    start: DeckStart
    highest: float  # maximum height of the piston, or of a bed without a piston [m]
    longest_step: float  # [s]

    @property
    def wall_laws(self) -> dict[str, str]:
        """Laws of the active walls by side: left, right, bottom or top (the piston)."""
        walls = self.scene.effects.walls
        if walls is None:
            return {}
        result = {side: walls.wall_of(side) for side in FACES}
        if self.scene.piston is None:
            del result["top"]
        return {side: wall.law for side, wall in result.items() if wall is not None}

    @property
    def grain_groups_by_decay_rate(self) -> list[tuple[str, str, int]]:
        """List the groups of equal decay rate, each as variable suffix, name, and index of a species."""
        drag, grains = self.scene.effects.drag, self.scene.grains
        if drag is None or (grains.face_area_ratios() == grains.mass_ratios()).all():
            return [("", "all", 0)]
        return [(str(k + 1), f"species{k + 1}", k) for k in range(len(self.mass_ratios))]

    @property
    def pair_cutoff(self) -> float | None:
        """Distance [D] beyond which two grains exert no force; None without magnetic forces."""
        if self.scene.effects.dipole is None:
            return None
        # A mesh adds all remaining pairs to the near part.
        method = "direct" if self.scene.pair_method == "mesh" else self.scene.pair_method
        radius = self.scene.pairs.near_pair_radius(method, self.scales.length)
        diagonal = math.hypot(self.scene.cell.width, self.highest) / self.scales.length
        closed = len(self.wall_laws) == len(FACES)
        return radius or diagonal * (1.0 if closed else OPEN_MARGIN)

    @property
    def wall_cutoff(self) -> float:
        """Distance [D] beyond which a wall exerts no force."""
        longest = max(self.scene.cell.width, self.highest) / self.scales.length
        return min(MAXIMUM_WALL_DISTANCE, longest * OPEN_MARGIN)

    def species_pairs(self) -> list[tuple[int, int]]:
        """List the unordered pairs of species (first <= second), numbered from 1 as in LAMMPS."""
        return list(itertools.combinations_with_replacement(range(1, len(self.moment_ratios) + 1), 2))


def pair_table_name(first: int, second: int) -> str:
    """Return the name of the repulsion table of two species."""
    return f"PAIR_{first}_{second}"


def wall_table_name(law: str, species: int) -> str:
    """Return the name of the repulsion table of a species and a wall."""
    return f"WALL_{law.upper()}_{species}"


def input_script_lines(deck: LammpsDeck) -> Iterator[str]:
    """Yield the lines of the LAMMPS input script, in SI and without line endings."""
    yield from _initialization_lines(deck)
    yield from _pair_style_lines(deck)
    yield from _wall_force_lines(deck)
    yield from _drag_lines(deck)
    yield from _gravity_and_shaking_lines(deck)
    yield "fix plane all enforce2d"
    yield "fix motion all nve"
    yield "fix share all balance 1000 1.1 shift xy 20 1.05"
    yield ""
    yield from _output_lines(deck)
    for stage in deck.start.remaining_stages:
        yield from _stage_lines(deck, stage)


def _initialization_lines(deck: LammpsDeck) -> Iterator[str]:
    scene = deck.scene
    yield f"# Scene {scene.name!r}: {scene.grains.count} grains, in SI. Run it in parallel with"
    yield "#   mpirun -np 2 lmp -in in.granular"
    yield "# which writes the piston's record to piston.csv and the grains to frames.dump."
    yield "units si"
    yield "dimension 2"
    yield "boundary m m p"
    yield "atom_style atomic"
    yield "read_data bed.data"
    yield f"reset_timestep 0 time {deck.start.time!r}"
    for number in range(1, len(deck.moment_ratios) + 1):
        yield f"group species{number} type {number}"
    yield ""


def _pair_style_lines(deck: LammpsDeck) -> Iterator[str]:
    length, count = deck.scales.length, deck.scene.grains.count
    if deck.pair_cutoff is None:
        yield f"pair_style zero {length!r}"
        yield "pair_coeff * *"
    else:
        yield f"pair_style table bitmap {PAIR_BITS}"
        for first, second in deck.species_pairs():
            name = pair_table_name(first, second)
            yield f"pair_coeff {first} {second} pairs.table {name} {deck.pair_cutoff * length!r}"
    yield f"neighbor {length!r} bin"
    # If all pairs are summed, every other grain is a neighbour.
    most = max(2000, count)
    # Neither value is below its LAMMPS default; "page" must be at least ten times "one" (neigh_modify).
    yield f"neigh_modify every 1 delay 0 check yes one {most} page {max(100_000, 10 * most)}"
    yield ""


def _wall_force_lines(deck: LammpsDeck) -> Iterator[str]:
    if not deck.wall_laws:
        return
    coordinates = {"left": "0.0", "right": repr(deck.scene.cell.width), "bottom": "0.0"}
    if "top" in deck.wall_laws:
        yield f"variable height equal {deck.start.height!r}"
    reach = deck.wall_cutoff * deck.scales.length
    for number in range(1, len(deck.moment_ratios) + 1):
        walls = " ".join(
            f"{FACES[side]} {coordinates.get(side, 'v_height')} walls.table "
            f"{wall_table_name(law, number)} {reach!r}"
            for side, law in deck.wall_laws.items()
        )
        yield f"fix walls{number} species{number} wall/table spline {WALL_ROWS} {walls}"
        yield f"fix_modify walls{number} energy yes"
    for position, side in enumerate(deck.wall_laws, start=1):
        terms = "+".join(f"f_walls{k}[{position}]" for k in range(1, len(deck.moment_ratios) + 1))
        # LAMMPS gives forces along the axes; the record holds outward forces.
        outwards = "" if side in ("right", "top") else "-"
        yield f"variable force_{side} equal {outwards}({terms})"
    yield ""


def _drag_lines(deck: LammpsDeck) -> Iterator[str]:
    """Yield the lines for drag, with modified masses for which a time step with drag is exact."""
    drag = deck.scene.effects.drag
    moving = drag is not None and drag.coefficient > 0.0
    if drag is not None and moving:
        yield "# Masses are multiplied by c dt/(1 - exp(-c dt)), where c is the decay rate. A step with"
        yield "# fix viscous is then exact for force and drag. Gravity is divided by the same factor."
        faces = deck.scene.grains.face_area_ratios().tolist()
        for suffix, _, species in deck.grain_groups_by_decay_rate:
            relative = faces[species] / deck.mass_ratios[species]
            yield f"variable rate{suffix} equal {relative * drag.coefficient / deck.scales.mass!r}"
        fractions = "".join(f" scale {k} {face!r}" for k, face in enumerate(faces, start=1))
        yield f"fix drag all viscous {drag.coefficient!r}{fractions}"
    for suffix, _, _ in deck.grain_groups_by_decay_rate:
        stretch = f"v_rate{suffix}*dt/(1.0-exp(-v_rate{suffix}*dt))" if moving else "1.0"
        yield f"variable stretch{suffix} equal {stretch}"
    for number, mass in enumerate(deck.mass_ratios, start=1):
        suffix = deck.grain_groups_by_decay_rate[
            number - 1 if len(deck.grain_groups_by_decay_rate) > 1 else 0
        ][0]
        yield f"variable mass{number} equal {mass * deck.scales.mass!r}*v_stretch{suffix}"
    for suffix, group, _ in deck.grain_groups_by_decay_rate:
        yield f"compute motion{suffix} {group} ke"
    total = "+".join(
        f"c_motion{suffix}/v_stretch{suffix}" for suffix, _, _ in deck.grain_groups_by_decay_rate
    )
    yield f"variable kinetic equal {total}"


def _gravity_and_shaking_lines(deck: LammpsDeck) -> Iterator[str]:
    """Yield the lines for gravity and shaking, as accelerations: the scene's forces divided by its masses."""
    gravity, shaking = deck.scene.effects.gravity, deck.scene.effects.shaking
    for suffix, group, _ in deck.grain_groups_by_decay_rate:
        if gravity is not None:
            yield f"variable weight{suffix} equal {gravity.acceleration!r}/v_stretch{suffix}"
            yield f"fix gravity{suffix} {group} gravity v_weight{suffix} vector 0 -1 0"
            yield f"fix_modify gravity{suffix} energy yes"
        if shaking is not None:
            omega = 2.0 * math.pi * shaking.frequency
            size = shaking.amplitude * omega**2
            shaking_formula = f"{size!r}*sin({omega!r}*time)/v_stretch{suffix}"
            yield f"variable swing{suffix} equal {shaking_formula}"
            direction = f"{math.cos(shaking.angle)!r} {math.sin(shaking.angle)!r} 0"
            yield f"fix swing{suffix} {group} gravity v_swing{suffix} vector {direction}"


def _record_and_frame_intervals(deck: LammpsDeck) -> tuple[int, int]:
    """Return the number of steps per record, and of records per frame."""
    output = deck.scene.output
    return max(1, math.ceil(output.scalars / deck.longest_step - 1e-9)), output.records_per_frame


def _output_lines(deck: LammpsDeck) -> Iterator[str]:
    every, frames = _record_and_frame_intervals(deck)
    columns = {"time [s]": "time"}
    if "top" in deck.wall_laws:
        columns |= {"height [m]": "height", "force [N]": "force_top"}
    columns |= {f"force_{side} [N]": f"force_{side}" for side in deck.wall_laws if side != "top"}
    values = ",".join(f"${{{name}}}" for name in columns.values())
    yield "variable time equal time"
    shown = " ".join(f"v_{name}" for name in list(columns.values())[1:])
    yield f"thermo_style custom step time pe v_kinetic {shown}".rstrip()
    yield f"thermo {every * frames}"
    yield f"dump frames all custom {every * frames} frames.dump id type x y vx vy fx fy"
    yield "dump_modify frames sort id format float %.17g time yes units yes"
    yield "variable t equal 0.0"
    yield f"timestep {_longest_step_dividing_record_interval(deck)!r}"
    yield from _mass_lines(deck)
    yield "run 0"
    yield f'print "{",".join(columns)}" file piston.csv screen no'
    # With a constant instead of v_next, records would be repeated at the boundary of two stages; the title is
    # the initial record.
    yield f"variable next equal step+{every}"
    yield f'fix record all print v_next "{values}" append piston.csv screen no title {values}'
    yield ""


def _mass_lines(deck: LammpsDeck) -> Iterator[str]:
    for number in range(1, len(deck.moment_ratios) + 1):
        yield f"mass {number} ${{mass{number}}}"


def _longest_step_dividing_record_interval(deck: LammpsDeck) -> float:
    """Return the longest allowed step [s] that divides the record interval."""
    return deck.scene.output.scalars / _record_and_frame_intervals(deck)[0]


def _stage_lines(deck: LammpsDeck, stage: RemainingStage) -> Iterator[str]:
    yield f"# Stage {stage.name}: {stage.kind}, {stage.remaining_duration:g} s"
    if stage.path is not None and "top" in deck.wall_laws:
        yield f"variable height equal {stage.path.formula}"
    if stage.remaining_duration <= 0.0:
        return
    steps = max(1, math.ceil(stage.remaining_duration / _longest_step_dividing_record_interval(deck) - 1e-6))
    started = f"+{stage.elapsed!r}" if stage.elapsed else ""
    yield f"variable t equal elapsed*dt{started}"
    yield f"timestep {stage.remaining_duration / steps!r}"
    yield from _mass_lines(deck)
    yield f"run {steps}"
    yield ""
