"""Export of a scene as an input deck of LAMMPS, to run it on many processors.

The deck contains the repulsion of dipoles or discs and of walls as tables (for any number of species),
gravity, viscous drag, shaking and a prescribed piston. Scenes with one of the following are refused, because
LAMMPS has no equivalent: dry friction, contact, walls that depend on two coordinates, a free piston, and
stages that end at rest or at a force. See ``docs/large-scale.md``.

The tables give forces with relative errors of about 1e-7. LAMMPS then makes the same time steps as the
method ``stormer-verlet``, also with drag.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from granular.effects.dipole import discs_unless_dipoles
from granular.export.exporter import Exporter
from granular.export.frames import load_run_if_path, present_grain_indices_and_frame
from granular.export.lammps_script import (
    WALLS,
    DeckStart,
    LammpsDeck,
    check_exportable_scene,
    input_script_lines,
    pair_table_lines,
    wall_table_lines,
)
from granular.export.lammps_stages import RemainingStage, convert_stage_for_lammps
from granular.observables.frame import frame_at
from granular.pairs import dipole_law
from granular.pairs.disc_law import Disc, disc_over_dipole_stiffness, make_all_pairs_and_near_disc_laws
from granular.run.run_directory import is_run_directory
from granular.run.trajectory import Trajectory, load_trajectory
from granular.scene.named_scenes import load_scene
from granular.scene.scene import Scene
from granular.schema.natural_units import Scales
from granular.shared.array_types import Float
from granular.shared.files import write_line_files


def to_lammps(
    source: Scene | Trajectory | str | Path,
    directory: str | Path,
    *,
    dt: float | str = "auto",
    overwrite: bool = False,
) -> tuple[Path, ...]:
    """Write a LAMMPS deck in SI: ``in.granular``, ``bed.data``, and the tables of pairs and walls.

    ``mpirun -np 2 lmp -in in.granular``, in that directory, runs the protocol and writes ``piston.csv``
    (which `PistonRecord.from_csv` reads) and ``frames.dump``. A scene starts from its initial state. A run
    continues from its last frame with the rest of its protocol; for a complete run only the forces are
    computed. With ``pairs.method = "cut-off"``, the deck has the scene's cut-off. Otherwise all pairs are
    summed, at a cost proportional to the square of the number of grains.

    Parameters
    ----------
    source : Scene, Trajectory, str or path
        A scene, a run, the name of a packaged scene, or the path of a scene or run.
    directory : path
        Directory of the deck; created if missing.
    dt : float or str
        Maximum time step [s]. The deck uses the longest step up to this value that divides the interval of
        the records. In each stage the step is shortened, if necessary, to divide the duration. "auto"
        resolves the stiffest mode of the present bed and of the bed compressed uniformly to the piston's
        lowest height; "auto/2" is half of that step.
    overwrite : bool
        Whether existing files may be replaced.

    Returns
    -------
    tuple of Path
        Paths of the written files.

    Raises
    ------
    InputError
        If LAMMPS cannot represent the scene, ``dt`` is not a time step, a file exists or cannot be written,
        or the source cannot be read.
    """
    scene, run = _scene_and_run_of_source(source)
    check_exportable_scene(scene)
    start = _deck_start_of_scene(scene) if run is None else _deck_start_after_run(run)
    deck = _make_deck(scene, start, dt)
    contents = {
        "in.granular": (f"{line}\n" for line in input_script_lines(deck)),
        "bed.data": _data_file_lines(deck),
        "pairs.table": pair_table_lines(deck),
        "walls.table": wall_table_lines(deck),
    }
    return write_line_files(Path(directory), contents, overwrite)


def _scene_and_run_of_source(source: Scene | Trajectory | str | Path) -> tuple[Scene, Trajectory | None]:
    if isinstance(source, Scene):
        return source, None
    if not isinstance(source, Trajectory):
        if not is_run_directory(Path(source)):
            return load_scene(source), None
        source = load_trajectory(source)
    return source.scene, load_run_if_path(source)


def _deck_start_of_scene(scene: Scene) -> DeckStart:
    height = None if scene.piston is None else scene.piston.height
    all_grains = np.arange(scene.grains.count)
    return DeckStart(
        0.0,
        height,
        all_grains,
        *scene.initial_positions_and_velocities(),
        tuple(_remaining_stages(scene, 0, height)),
    )


def _deck_start_after_run(run: Trajectory) -> DeckStart:
    """Return the state in the last frame of a run, with the remaining stages of the run's protocol."""
    grains, frame = present_grain_indices_and_frame(frame_at(run))
    completed_stages = [stage for stage in run.stages if stage.reason != "cut" and stage.end <= frame.time]
    current_height = None if run.scene.piston is None else frame.piston_height
    height, stage_start, stage_index = current_height, frame.time, len(completed_stages)
    if stage_index < len(run.stages):
        current_stage = run.stages[stage_index]
        stage_start = current_stage.start
        if height is not None:
            height = float(run.piston(current_stage.name).height[0])
    stages = tuple(_remaining_stages(run.scene, stage_index, height, frame.time - stage_start))
    return DeckStart(frame.time, current_height, grains, frame.positions, frame.velocities, stages)


def _remaining_stages(
    scene: Scene, index: int, height: float | None, elapsed: float = 0.0
) -> Iterator[RemainingStage]:
    """Yield the stages from ``index`` on; the first stage starts with the piston at ``height`` [m]."""
    for stage in scene.protocol[index:]:
        remaining = convert_stage_for_lammps(stage, height, elapsed)
        yield remaining
        height, elapsed = None if remaining.path is None else remaining.path.end, 0.0


def _make_deck(scene: Scene, start: DeckStart, dt: float | str) -> LammpsDeck:
    scales = Scales.from_grains(scene.grains)
    paths = [stage.path for stage in start.remaining_stages if stage.path is not None]
    top = float(start.positions[:, 1].max()) if start.height is None else start.height
    deck = LammpsDeck(
        scene=scene,
        scales=scales,
        moment_ratios=tuple(scene.grains.moment_ratios().tolist()),
        mass_ratios=tuple(scene.grains.mass_ratios().tolist()),
        start=start,
        highest=max([top, *(path.highest for path in paths)]),
        longest_step=math.inf,
    )
    return deck._replace(longest_step=_choose_time_step(deck, dt))


def _choose_time_step(deck: LammpsDeck, dt: float | str) -> float:
    """Return the requested time step [s] or, for "auto", the step that the bed's stiffest modes allow."""
    from granular.run.plan import parse_time_step

    requested = parse_time_step(dt, deck.scene)
    if requested.seconds is not None:
        return requested.seconds
    highest = max(_highest_mode_frequency_under_compression(deck), _highest_collision_frequency(deck))
    highest *= deck.scales.rate
    return min(deck.scene.output.scalars, requested.step_times_frequency / highest if highest else math.inf)


def _highest_mode_frequency_under_compression(deck: LammpsDeck) -> float:
    """Return the highest angular frequency [1/tau] of the present bed and of the compressed bed."""
    start, unit = deck.start, deck.scales.length
    position, width = start.positions / unit, deck.scene.cell.width / unit
    species = deck.scene.grains.species_indices()[start.grains]
    discs = discs_unless_dipoles(deck.scene.grains, unit)
    moment_ratio, mass = np.array(deck.moment_ratios)[species], np.array(deck.mass_ratios)[species]
    height = deck.highest if start.height is None else start.height
    heights = [stage.path.lowest for stage in start.remaining_stages if stage.path is not None]
    fractions = {1.0, *(low / height for low in heights)}
    return max(
        upper_bound_of_mode_frequencies(
            position * [1.0, fraction],
            moment_ratio,
            mass,
            deck.wall_laws,
            width,
            height * fraction / unit,
            pairs=deck.pair_cutoff is not None,
            discs=tuple(discs[k] for k in species) if discs else (),
        )
        for fraction in (1.0, min(fractions))
    )


def _highest_collision_frequency(deck: LammpsDeck) -> float:
    """Return the highest frequency [1/tau] of head-on collisions of grains with each other or a wall."""
    start, gravity = deck.start, deck.scene.effects.gravity
    fall = 0.0 if gravity is None else 2.0 * gravity.acceleration * start.positions[:, 1].max()
    speed = math.sqrt((start.velocities**2).sum(axis=1).max() + fall)
    speed += max(
        (stage.path.speed for stage in start.remaining_stages if stage.path is not None), default=0.0
    )
    speed /= deck.scales.velocity
    discs, squares = discs_unless_dipoles(deck.scene.grains, deck.scales.length), []
    for moment_ratio, mass in zip(deck.moment_ratios, deck.mass_ratios, strict=True):
        ratio = moment_ratio / mass
        scaled_speed = speed / math.sqrt(ratio)
        laws = set(deck.wall_laws.values())
        squares += [ratio * WALLS[law][0].turning_point_stiffness(None, scaled_speed) for law in laws]
        if deck.pair_cutoff is not None and not discs:
            squares.append(dipole_law.squared_dipole_impact_frequency(speed, mass, moment_ratio))
        elif deck.pair_cutoff is not None:
            near_law = make_all_pairs_and_near_disc_laws(discs, np.zeros(0, dtype=np.int64))[1]
            speeds, frequencies = near_law.tables.collisions
            strength = moment_ratio * ratio
            row = min(np.searchsorted(speeds, speed**2 / strength), len(speeds) - 1)
            squares.append(strength * frequencies[row])
    return math.sqrt(max(squares, default=0.0))


def _data_file_lines(deck: LammpsDeck) -> Iterator[str]:
    """Yield the lines of the data file: grains in the order of the scene, numbered from 1."""
    start = deck.start
    species = deck.scene.grains.species_indices()[start.grains] + 1
    depth = deck.scene.cell.separation
    yield f"Scene {deck.scene.name!r} at {start.time:.9g} s\n\n"
    yield f"{len(species)} atoms\n{len(deck.moment_ratios)} atom types\n\n"
    sizes = (deck.scene.cell.width, deck.highest)
    for axis, size, position in zip("xy", sizes, start.positions.T, strict=True):
        # Grains may lie outside an open cell.
        low = min(0.0, float(position.min()) - deck.scales.length)
        high = max(size, float(position.max()) + deck.scales.length)
        yield f"{low!r} {high!r} {axis}lo {axis}hi\n"
    yield f"{-depth / 2.0!r} {depth / 2.0!r} zlo zhi\n\nAtoms # atomic\n\n"
    columns = (start.grains + 1, species, *start.positions.T)
    for row in zip(*(column.tolist() for column in columns), strict=True):
        yield "{} {} {!r} {!r} 0\n".format(*row)
    yield "\nVelocities\n\n"
    for row in zip(*(column.tolist() for column in (start.grains + 1, *start.velocities.T)), strict=True):
        yield "{} {!r} {!r} 0\n".format(*row)


REACH = 6.0
"""Distance [D] within which pairs are included in the stiffness; the stiffness decreases as distance^-5."""


def upper_bound_of_mode_frequencies(
    positions: Float[np.ndarray, "n 2"],
    moment_ratio: Float[np.ndarray, "n"],
    mass_ratio: Float[np.ndarray, "n"],
    walls: Mapping[str, str],
    width: float,
    height: float,
    *,
    pairs: bool,
    discs: Sequence[Disc] = (),
) -> float:
    """Bound the modes' angular frequencies [1/tau] by row sums of the stiffness matrix; lengths are in D."""
    from scipy.spatial import cKDTree

    near_pairs = cKDTree(positions).query_pairs(REACH if pairs else 0.0, output_type="ndarray")
    i, j = near_pairs[:, 0], near_pairs[:, 1]
    r = np.linalg.norm(positions[i] - positions[j], axis=1)
    inverse_fifth_power = r**-5.0
    if discs:
        disc_pairs = [(discs[first], discs[second]) for first, second in near_pairs]
        for pair in set(disc_pairs):
            same_pair = np.array([other == pair for other in disc_pairs])
            inverse_fifth_power[same_pair] *= disc_over_dipole_stiffness(r[same_pair], pair)
    size = len(positions)
    sums = np.bincount(i, moment_ratio[j] * inverse_fifth_power, size) + np.bincount(
        j, moment_ratio[i] * inverse_fifth_power, size
    )
    # The stiffness 4 * 3/4 q_i q_j/r^5 of a pair enters a row twice.
    rows = np.multiply(8.0 * dipole_law.STRENGTH, sums)
    gaps = {
        "left": positions[:, 0],
        "right": width - positions[:, 0],
        "bottom": positions[:, 1],
        "top": height - positions[:, 1],
    }
    for side, law in walls.items():
        rows += [WALLS[law][0].stiffness(None, gap) for gap in gaps[side]]
    # Gershgorin's circles bound the eigenvalues (Horn and Johnson, Matrix Analysis, theorem 6.1.1).
    return math.sqrt(float((rows * (moment_ratio / mass_ratio)).max()))


LAMMPS = Exporter(
    to_lammps, "LAMMPS deck", of_scenes=True, next_step="in that directory: mpirun -np 2 lmp -in in.granular"
)
