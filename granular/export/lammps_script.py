"""The input script of LAMMPS for a scene, as text, and its tables of pair and wall laws, in SI."""

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
from granular.pairs.disc_law import disc_law_continued_below_contact, force_slope_at_contact
from granular.scene.scene import Scene
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError

ROWS = 5000
"""Rows of a table, in geometric steps: LAMMPS draws a cubic spline through them, which is exact to
1e-9 of the force."""

NEAREST_PAIR, NEAREST_WALL = 0.25, 0.1
"""First distances of the tables, in diameters of the smallest species; LAMMPS stops at a grain nearer."""

FARTHEST_WALL = 200.0
"""Greatest last distance of the walls' tables [D]; the experimental wall's force there is 5e-9 F*."""

WALLS: dict[str, tuple[Any, float]] = {
    "experimental": (ExperimentalWall, 3.5),
    "infinite": (InfiniteWall, 3.0),
}
"""Laws that depend on the distance alone, with the power by which their force falls."""

_PAIR_EXPONENT = 4.0


def pair_table_lines(deck: LammpsDeck) -> Iterator[str]:
    """Yield the lines of the tables of the repulsion of each two species [m, J, N]."""
    if deck.pair_cutoff is None:
        return
    r = np.geomspace(NEAREST_PAIR * math.sqrt(min(deck.moment_ratios)), deck.pair_cutoff, ROWS)
    discs = discs_unless_dipoles(deck.scene.grains, deck.scales.length)
    for first, second in deck.species_pairs():
        energy, force = dipole_law.ENERGY / r**3, dipole_law.STRENGTH / r**4
        slopes = -_PAIR_EXPONENT * force[[0, -1]] / r[[0, -1]]
        if discs:
            pair = discs[first - 1], discs[second - 1]
            energy, force = (dipole_law.ENERGY * part for part in disc_law_continued_below_contact(r, pair))
            slopes = np.array(
                [dipole_law.ENERGY * force_slope_at_contact(*pair), -_PAIR_EXPONENT * force[-1] / r[-1]]
            )
        product = deck.moment_ratios[first - 1] * deck.moment_ratios[second - 1]
        law = product * energy, product * force, product * slopes
        yield from _table_lines(pair_table_name(first, second), "FPRIME", deck.scales, r, *law)


def wall_table_lines(deck: LammpsDeck) -> Iterator[str]:
    """Yield the lines of the tables of each wall's repulsion of each species, a power law [m, J, N]."""
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
    """Section of a table file in SI, of a law in natural units with its slopes at both ends."""
    first, last = (slopes * (scales.force / scales.length)).tolist()
    yield f"{name}\nN {ROWS} {slope_keyword} {first:.17g} {last:.17g}\n\n"
    rows = np.column_stack([distance * scales.length, energy * scales.energy, force * scales.force])
    for number, row in enumerate(rows.tolist(), start=1):
        yield "{} {:.17g} {:.17g} {:.17g}\n".format(number, *row)
    yield "\n"


PAIR_BITS, WALL_ROWS = 16, 100_000
"""Size of the tables that LAMMPS looks up: 2^16 rows spaced as floating-point numbers are, read by
straight lines, for pairs; even steps, read by splines, for walls."""

FACES = {"left": "xlo", "right": "xhi", "bottom": "ylo", "top": "yhi"}

OPEN_MARGIN = 2.0
"""Cut-off of pairs in diagonals of the cell, if a side is open."""


CARRIED = ("dipole", "walls", "gravity", "drag", "shaking")
"""Effects that a deck has."""
_REASONS = {
    "friction": ": LAMMPS has no dry friction that lets grains stick under this load",
    "contact": ": the dashpot of a contact is no function of the distance alone",
}


def check_exportable_scene(scene: Scene) -> None:
    """Refuse a scene that a LAMMPS deck cannot carry."""
    effects, walls = scene.effects, scene.effects.walls
    if scene.grains.count == 0:
        raise InputError("grains.count = 0; LAMMPS needs at least 1 grain")
    for effect in effects.acting:
        if effect.key not in CARRIED:
            raise InputError(
                f"effects.{effect.key} cannot be exported to LAMMPS{_REASONS.get(effect.key, '')}; leave it "
                f"out (--set effects.{effect.key}=none) or run the scene here"
            )
    if scene.grains.spread > 0.0:
        raise InputError(
            "grains.spread cannot be exported to LAMMPS, whose tables are of species; set it to 0"
        )
    if scene.cell.is_polygon:
        raise InputError(
            "cell.sides cannot be exported to LAMMPS, whose walls by tables are upright or level; write "
            "the frames as extended XYZ, GSD or VTK, or give cell.width"
        )
    for side, wall in () if walls is None else walls.present_walls:
        if wall.law not in WALLS:
            why = "it depends on two coordinates" if wall.own is None else "no deck has its law"
            raise InputError(
                f"effects.walls.{side}.law = {wall.law!r} cannot be exported to LAMMPS: {why}; take "
                f"{' or '.join(map(repr, WALLS))}"
            )
    if scene.cell.periods is not None:
        raise InputError(
            "cell.sides = 'periodic': the script for LAMMPS has walls alone; write the frames as "
            "extended XYZ, whose lattice is periodic"
        )
    if scene.pair_method == "verlet-list":
        raise InputError(
            "pairs.method = 'verlet-list' cannot be exported to LAMMPS, whose lists miss no pair; "
            "take 'cut-off' with the same radius"
        )


class DeckStart(NamedTuple):
    """State in which the deck begins, in SI, and the stages from there on."""

    time: float
    height: float | None  # of the piston; None without one
    grains: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    remaining_stages: tuple[RemainingStage, ...]


class LammpsDeck(NamedTuple):
    """Contents of the input script."""

    scene: Scene
    scales: Scales
    moment_ratios: tuple[float, ...]  # of each species over the first
    mass_ratios: tuple[float, ...]  # likewise
    start: DeckStart
    highest: float  # largest height of the piston, or of the bed without one [m]
    longest_step: float  # [s]

    @property
    def wall_laws(self) -> dict[str, str]:
        """Law of each wall that acts, by its side: left, right, bottom or top (the piston)."""
        walls = self.scene.effects.walls
        if walls is None:
            return {}
        result = {side: walls.wall_of(side) for side in FACES}
        if self.scene.piston is None:
            del result["top"]
        return {side: wall.law for side, wall in result.items() if wall is not None}

    @property
    def decay_rate_groups(self) -> list[tuple[str, str, int]]:
        """Grains of one decay rate: suffix of their variables, their name in LAMMPS, a species."""
        drag, grains = self.scene.effects.drag, self.scene.grains
        if drag is None or (grains.face_area_ratios() == grains.mass_ratios()).all():
            return [("", "all", 0)]
        return [(str(k + 1), f"species{k + 1}", k) for k in range(len(self.mass_ratios))]

    @property
    def pair_cutoff(self) -> float | None:
        """Distance beyond which two grains exert no force [D]; None without magnetic forces."""
        if self.scene.effects.dipole is None:
            return None
        # What a mesh adds to its near part is the rest of all pairs.
        method = "direct" if self.scene.pair_method == "mesh" else self.scene.pair_method
        radius = self.scene.pairs.near_pair_radius(method, self.scales.length)
        diagonal = math.hypot(self.scene.cell.width, self.highest) / self.scales.length
        closed = len(self.wall_laws) == len(FACES)
        return radius or diagonal * (1.0 if closed else OPEN_MARGIN)

    @property
    def wall_cutoff(self) -> float:
        """Distance beyond which a wall exerts no force [D]."""
        longest = max(self.scene.cell.width, self.highest) / self.scales.length
        return min(FARTHEST_WALL, longest * OPEN_MARGIN)

    def species_pairs(self) -> list[tuple[int, int]]:
        """List the unordered pairs of species (first <= second), counted from 1 as LAMMPS does."""
        return list(itertools.combinations_with_replacement(range(1, len(self.moment_ratios) + 1), 2))


def pair_table_name(first: int, second: int) -> str:
    """Name the table of the repulsion of two species."""
    return f"PAIR_{first}_{second}"


def wall_table_name(law: str, species: int) -> str:
    """Name the table of the repulsion of a species from a wall."""
    return f"WALL_{law.upper()}_{species}"


def input_script_lines(deck: LammpsDeck) -> Iterator[str]:
    """Yield the lines of the LAMMPS input script, in SI and without line ends."""
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
    # With all pairs summed, every other grain is a neighbour.
    most = max(2000, count)
    # Neither is below its default in LAMMPS, and page has to be ten times one at least (neigh_modify).
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
        # LAMMPS counts forces along the axes, the record outwards.
        outwards = "" if side in ("right", "top") else "-"
        yield f"variable force_{side} equal {outwards}({terms})"
    yield ""


def _drag_lines(deck: LammpsDeck) -> Iterator[str]:
    """Drag, and the masses that make its step exact."""
    drag = deck.scene.effects.drag
    moving = drag is not None and drag.coefficient > 0.0
    if drag is not None and moving:
        yield "# With masses larger by c dt/(1 - exp(-c dt)), c being the decay rate, a step with"
        yield "# fix viscous is the exact flow of force and drag; gravity is smaller by as much."
        faces = deck.scene.grains.face_area_ratios().tolist()
        for suffix, _, species in deck.decay_rate_groups:
            relative = faces[species] / deck.mass_ratios[species]
            yield f"variable rate{suffix} equal {relative * drag.coefficient / deck.scales.mass!r}"
        fractions = "".join(f" scale {k} {face!r}" for k, face in enumerate(faces, start=1))
        yield f"fix drag all viscous {drag.coefficient!r}{fractions}"
    for suffix, _, _ in deck.decay_rate_groups:
        stretch = f"v_rate{suffix}*dt/(1.0-exp(-v_rate{suffix}*dt))" if moving else "1.0"
        yield f"variable stretch{suffix} equal {stretch}"
    for number, mass in enumerate(deck.mass_ratios, start=1):
        suffix = deck.decay_rate_groups[number - 1 if len(deck.decay_rate_groups) > 1 else 0][0]
        yield f"variable mass{number} equal {mass * deck.scales.mass!r}*v_stretch{suffix}"
    for suffix, group, _ in deck.decay_rate_groups:
        yield f"compute motion{suffix} {group} ke"
    total = "+".join(f"c_motion{suffix}/v_stretch{suffix}" for suffix, _, _ in deck.decay_rate_groups)
    yield f"variable kinetic equal {total}"


def _gravity_and_shaking_lines(deck: LammpsDeck) -> Iterator[str]:
    """Gravity and shaking: accelerations, of the forces on the true masses."""
    gravity, shaking = deck.scene.effects.gravity, deck.scene.effects.shaking
    for suffix, group, _ in deck.decay_rate_groups:
        if gravity is not None:
            yield f"variable weight{suffix} equal {gravity.acceleration!r}/v_stretch{suffix}"
            yield f"fix gravity{suffix} {group} gravity v_weight{suffix} vector 0 -1 0"
            yield f"fix_modify gravity{suffix} energy yes"
        if shaking is not None:
            omega = 2.0 * math.pi * shaking.frequency
            size = shaking.amplitude * omega**2
            swing = f"{size!r}*sin({omega!r}*time)/v_stretch{suffix}"
            yield f"variable swing{suffix} equal {swing}"
            along = f"{math.cos(shaking.angle)!r} {math.sin(shaking.angle)!r} 0"
            yield f"fix swing{suffix} {group} gravity v_swing{suffix} vector {along}"


def _output_intervals(deck: LammpsDeck) -> tuple[int, int]:
    """Return the steps from record to record, and records from frame to frame."""
    output = deck.scene.output
    return max(1, math.ceil(output.scalars / deck.longest_step - 1e-9)), output.records_per_frame


def _output_lines(deck: LammpsDeck) -> Iterator[str]:
    every, frames = _output_intervals(deck)
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
    yield f"timestep {_step_dividing_record_interval(deck)!r}"
    yield from _mass_lines(deck)
    yield "run 0"
    yield f'print "{",".join(columns)}" file piston.csv screen no'
    # With a number in place of v_next, records would come twice where two stages meet; the title
    # is the record of the start.
    yield f"variable next equal step+{every}"
    yield f'fix record all print v_next "{values}" append piston.csv screen no title {values}'
    yield ""


def _mass_lines(deck: LammpsDeck) -> Iterator[str]:
    for number in range(1, len(deck.moment_ratios) + 1):
        yield f"mass {number} ${{mass{number}}}"


def _step_dividing_record_interval(deck: LammpsDeck) -> float:
    """Longest step that divides the distance of the records [s]."""
    return deck.scene.output.scalars / _output_intervals(deck)[0]


def _stage_lines(deck: LammpsDeck, stage: RemainingStage) -> Iterator[str]:
    yield f"# Stage {stage.name}: {stage.kind}, {stage.remaining_duration:g} s"
    if stage.path is not None and "top" in deck.wall_laws:
        yield f"variable height equal {stage.path.formula}"
    if stage.remaining_duration <= 0.0:
        return
    steps = max(1, math.ceil(stage.remaining_duration / _step_dividing_record_interval(deck) - 1e-6))
    started = f"+{stage.elapsed!r}" if stage.elapsed else ""
    yield f"variable t equal elapsed*dt{started}"
    yield f"timestep {stage.remaining_duration / steps!r}"
    yield from _mass_lines(deck)
    yield f"run {steps}"
    yield ""
