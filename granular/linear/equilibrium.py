"""`equilibrium`: find the state in which all conservative forces of a bed vanish, by Newton's method.

If that fails, the bed relaxes downhill by the fast inertial relaxation engine (FIRE), with the published
parameters (Bitzek et al. 2006, doi:10.1103/PhysRevLett.97.170201). The fictitious mass of each coordinate
equals its stiffness. All coordinates then have the same period, and the unit of time is this period/(2 pi).
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
from pathlib import Path
from typing import Any

import numpy as np

from granular.linear.bed_forces import BedForces, has_dry_friction
from granular.linear.pencil import Pencil, make_pencil
from granular.protocol.stage import TimedStage
from granular.run.run_directory import is_run_directory
from granular.run.simulation import simulate
from granular.run.trajectory import Trajectory, load_trajectory, piston_heights_in_frames
from granular.scene.named_scenes import load_scene
from granular.scene.scene import Scene
from granular.schema.cell import Heights
from granular.shared.array_types import Float
from granular.shared.errors import InputError

_STEP, _LONGEST_STEP, _MIXING, _LATENCY, _MAXIMUM_STEPS = 0.1, 1.0, 0.1, 5, 20_000
_LONGEST_MOVE = 0.05
"""Maximum displacement of a grain in a step [D], so that it cannot pass through another grain or a wall."""

SOFTEST = 1e-3
"""Minimum ratio of smallest to largest fictitious mass; a grain without contacts has almost no stiffness."""

RELAXED = 1e-6
"""Ratio of the forces to their initial values below which Newton's method replaces the relaxation."""


def relax_until_forces_reduced(
    bed: BedForces,
    start: Float[np.ndarray, "q"],
    held: tuple[int, ...],
    stiffness: Float[np.ndarray, "q"],
    reduction: float,
) -> Float[np.ndarray, "q"]:
    """Relax from starting coordinates [m] until the forces are reduced by a given factor.

    ``stiffness`` [N/m] is the stiffness of each coordinate with all others held; it serves as its mass.
    """
    sizes = np.abs(stiffness)
    scaling = 1.0 / np.sqrt(np.maximum(sizes, SOFTEST * sizes.max()))
    at, velocity, step = start, np.zeros_like(start), _STEP
    mixing, downhill, first = _MIXING, 0, 0.0
    for _ in range(_MAXIMUM_STEPS):
        force = scaling * bed.forces(at)
        force[list(held)] = 0.0
        size = float(np.linalg.norm(force))
        first = first or size
        if size <= reduction * first:
            break
        if force @ velocity > 0.0:
            velocity = (1.0 - mixing) * velocity + mixing * np.linalg.norm(velocity) * force / size
            downhill += 1
            if downhill > _LATENCY:
                step, mixing = min(1.1 * step, _LONGEST_STEP), 0.99 * mixing
        else:
            velocity, step, mixing, downhill = np.zeros_like(at), 0.5 * step, _MIXING, 0
        velocity = velocity + step * force
        move = step * scaling * velocity
        at = at + move * min(1.0, _LONGEST_MOVE * bed.length / float(np.abs(move).max()))
    return at


REST = 1e-13
"""Maximum residual force at equilibrium, divided by the piston's weight or by the pair force at a distance of
one diameter, whichever is larger."""

SETTLED = 1e-7
"""Maximum distance to the equilibrium [D], estimated from Newton's step, if the force cannot fall to `REST`.

The force may stay above `REST` because of rounding, tabulated forces of discs, or a far field on a mesh.
Tabulated forces and far fields jump by 1e-7 times the pair force at a distance of one diameter."""

MAXIMUM_HALVINGS = 12
"""Maximum number of times that a Newton step is halved because it does not reduce the largest force."""

MAXIMUM_ITERATIONS, MAXIMUM_MATRICES = 60, 4
"""Maximum numbers of Newton steps and of stiffness matrices in a search for equilibrium.

A new stiffness matrix is computed only if the previous one has at least halved the largest force. Newton's
method therefore ends early if there is no equilibrium nearby. A settled bed of 368 grains takes three steps
and two matrices."""

FURTHER_REDUCTIONS = (1e-2, 1e-2)
"""Factors by which further relaxations reduce the forces if Newton's method still fails. In a bed whose
softest mode has a stiffness of 0.0026 N/m, Newton's method failed when started at forces of 1e-9 N, and
converged when started at 1e-11 N."""

LONGEST_STEP = 0.1
"""Maximum Newton step of a coordinate [D]; linearised forces are too inaccurate for larger steps."""

COARSE_REST = 0.01
"""Remaining motion [D] at which the simulated settling of a bed may end before Newton's method takes over.

For each of three packings of the packaged damper, values from 1e-4 to 0.1 D give the same equilibrium to
within 1e-9. With 0.01 D, settling takes 9 s of simulated time instead of 15 s."""

EIGENVALUES = 6
"""Number of eigenvalues of the stiffness that are reported, the lowest first."""


@dataclasses.dataclass(frozen=True, eq=False)
class Equilibrium:
    """Equilibrium of a bed.

    Attributes
    ----------
    scene : Scene
        Scene of the bed.
    positions : float64 (n, 2)
        Equilibrium positions of the grains [m].
    piston_height : float or None
        Equilibrium height of a free piston [m]; None without a free piston.
    residual : float
        Largest residual force [N].
    lowest_stiffness : float64 (k,)
        Lowest eigenvalues of the stiffness matrix [N/m]. In a periodic cell one grain is held fixed.
    is_stable : bool
        Whether every small displacement raises the energy, except uniform shifts in a periodic cell.
    frictionless : bool
        True if the scene has dry friction, which this equilibrium ignores. Friction can hold a bed at any
        height within (friction force)/(stiffness) of this equilibrium.
    pencil : Pencil
        Stiffness, damping and mass matrices about the equilibrium.
    """

    scene: Scene
    positions: Float[np.ndarray, "n 2"]
    piston_height: float | None
    residual: float
    frictionless: bool
    pencil: Pencil

    @property
    def heights(self) -> Float[np.ndarray, "p"]:
        """Heights of the piston (0 without a piston) and of further pistons [m]."""
        bed = self.pencil.bed
        return np.array([self.piston_height or 0.0, *self.pencil.at[bed.pistons : bed.bodies]])

    @functools.cached_property
    def lowest_stiffness(self) -> Float[np.ndarray, "k"]:
        """Lowest eigenvalues of the stiffness matrix [N/m]."""
        return self.pencil.lowest_eigenvalues_and_modes(
            EIGENVALUES, coordinates_to_pin_in_periodic_cell(self.pencil.bed)
        )[0]

    @property
    def is_stable(self) -> bool:
        """True if every small displacement raises the energy, except uniform shifts in a periodic cell."""
        return bool(self.lowest_stiffness[0] > 0.0)


def equilibrium(source: Scene | Trajectory | str | Path) -> Equilibrium:
    """Find the equilibrium closest to the settled state of a bed.

    All conservative effects are included: pairs, walls, weights, contacts, user-defined parts, and the
    springs of a machine.

    Parameters
    ----------
    source : Scene, Trajectory, str or Path
        If a run or its directory is given, its last frame is used. A scene is simulated up to the end of the
        first stage that ends at rest; a machine that carries the cell is omitted from this simulation.

    Returns
    -------
    Equilibrium
        Positions, height, residual force and the matrices of small motions.

    Raises
    ------
    InputError
        If the scene has no grains, grains have left through an open side of the cell, or there is no
        equilibrium near the settled state.

    Examples
    --------
    >>> from granular import damper, equilibrium
    >>> rest = equilibrium(damper(count=48, drop=24.0))
    >>> rest.is_stable, bool(rest.residual < 1e-9)  # [N]
    (True, True)
    """
    return equilibrium_from(*settled_scene_positions_and_heights(source))


def equilibrium_from(
    scene: Scene, positions: Float[np.ndarray, "n 2"], height: Heights, near: Pencil | None = None
) -> Equilibrium:
    """Find the equilibrium closest to given positions and heights of piston and further pistons [m].

    If ``near`` gives the matrices of a similar bed, the energy is first lowered by relaxation from these
    positions, which may rearrange the bed.
    """
    bed = BedForces(scene)
    if bed.has_force_jump_at_cut_off:
        remedy = "'direct'" if scene.cell.periods is None else "'mesh' (for 40 grains or more)"
        raise InputError(
            f"pairs.method = {scene.pair_method!r} cuts off pair forces at a distance at which "
            f"they are not zero, and forces that jump have no derivative; use {remedy}"
        )
    start = bed.coordinates(positions, height)
    far = _norm_of_forces(bed.forces(start)) > RELAXED * max(bed.scales.force, bed.weight)
    if far and (near is not None or has_dry_friction(scene)):
        # If friction held the bed off equilibrium, or values changed, Newton's method may end at a saddle.
        with contextlib.suppress(InputError):
            stiffness = (near or make_pencil(bed, start)).stiffness.diagonal()
            start = relax_until_forces_reduced(
                bed, start, coordinates_to_pin_in_periodic_cell(bed), stiffness, RELAXED
            )
    pencil = find_equilibrium_pencil(bed, start)
    at = pencil.at
    return Equilibrium(
        scene=scene,
        positions=bed.positions(at),
        piston_height=None if scene.piston is None else bed.piston_height(at),
        residual=float(np.abs(bed.forces(at)).max()),
        frictionless=has_dry_friction(scene),
        pencil=pencil,
    )


def settled_scene_positions_and_heights(
    source: Scene | Trajectory | str | Path,
) -> tuple[Scene, Float[np.ndarray, "n 2"], Float[np.ndarray, "p"]]:
    """Return scene, positions and heights [m] at the end of a run, or when a scene's bed first rests."""
    if not isinstance(source, Trajectory | Scene):
        source = load_trajectory(source) if is_run_directory(Path(source)) else load_scene(source)
    run = (
        source
        if isinstance(source, Trajectory)
        else simulate(source.replace(**scene_changes_to_end_at_rest(source)), progress=False)
    )
    positions = run.dataset["position"].values[-1]
    if not np.isfinite(positions).all():
        raise InputError(
            "the bed has no equilibrium, because grains have left the cell through an open side; remove "
            "gap_start and gap_end from effects.walls, and close all sides of the cell"
        )
    scene = source.scene if isinstance(source, Trajectory) else source
    return scene, positions, piston_heights_in_frames(run.scene, run.dataset)[-1]


def scene_changes_to_end_at_rest(scene: Scene, coarse: float = 0.0) -> dict[str, Any]:
    """Return changes to a scene that make its run end as soon as the bed rests.

    The bed counts as at rest if its remaining motion is below the stage's tolerance; ``coarse`` [D] replaces
    a smaller tolerance. A machine that carries the cell is removed; further pistons and the springs inside
    the cell remain.
    """
    if not scene.grains.count:
        raise InputError("the scene has no grains and therefore no bed; choose grains.count above 0")
    host: Any = getattr(scene.effects, "host", None)
    changes: dict[str, Any] = {"output.record": None}
    stages: list[dict[str, Any]] = scene.to_plain()["protocol"]
    rests = [isinstance(stage, TimedStage) and stage.until == "rest" for stage in scene.protocol]
    if host is not None:
        stages, rests = [{"name": "settle", "kind": "free", "until": "rest"}], [True]
        changes["effects.host"] = host.plain_host_without_machine()
        if host.cell_mass is not None:
            changes["piston.mass"] = host.cell_mass + float(scene.grains.masses().sum())
    if not any(rests):
        raise InputError(
            "no stage of the protocol ends at rest; add until = 'rest' to a stage, or pass the directory of "
            "a run"
        )
    stages = stages[: rests.index(True) + 1]
    if coarse:
        tolerance = coarse * scene.grains.species[0].diameter
        stages[-1]["tolerance"] = max(stages[-1].get("tolerance", 0.0), tolerance)
    return changes | {"protocol": stages}


def find_equilibrium_pencil(
    bed: BedForces, start: Float[np.ndarray, "q"], held: tuple[int, ...] = (), near: Pencil | None = None
) -> Pencil:
    """Return the matrices about the equilibrium closest to a state [m]; some coordinates can be held.

    If Newton's method finds no equilibrium from this state, the bed first relaxes downhill.
    """
    held = (*held, *coordinates_to_pin_in_periodic_cell(bed))
    first = near or make_pencil(bed, start)
    try:
        return _find_equilibrium_pencil_by_newton(bed, start, held, first, fresh=near is None)
    except InputError as error:
        with contextlib.suppress(InputError):  # for example, a bed without a floor falls out of its cell
            at = start
            for reduction in (RELAXED, *FURTHER_REDUCTIONS):
                at = relax_until_forces_reduced(bed, at, held, first.stiffness.diagonal(), reduction)
                with contextlib.suppress(InputError):
                    return _find_equilibrium_pencil_by_newton(bed, at, held, make_pencil(bed, at), fresh=True)
        raise error from None


def _find_equilibrium_pencil_by_newton(
    bed: BedForces, at: Float[np.ndarray, "q"], held: tuple[int, ...], pencil: Pencil, *, fresh: bool
) -> Pencil:
    """Solve for the equilibrium by Newton's method; coordinates [m].

    Steps share a matrix until a step reduces the force by less than a factor of ten (chord method).
    """
    free = np.delete(np.arange(bed.size), list(held))
    force = bed.forces(at)
    scale = max(bed.scales.force, bed.weight)
    matrices, before = 0, np.inf
    for _ in range(MAXIMUM_ITERATIONS):
        size = _norm_of_forces(force[free])
        if size <= REST * scale:
            return pencil if fresh else make_pencil(bed, at)
        step = pencil.solve(0.0, force[:, None], held)[:, 0]
        step *= min(1.0, LONGEST_STEP * bed.length / float(np.abs(step).max()))
        settled = float(np.abs(step).max()) <= SETTLED * bed.length
        for halving in range(MAXIMUM_HALVINGS):
            trial = at + 0.5**halving * step
            moved = _forces_or_infinite(bed, trial)
            if _norm_of_forces(moved[free]) < size:
                at, force = trial, moved
                break
        else:
            if fresh and settled:
                return pencil
            if fresh:
                break
        fresh = False
        if _norm_of_forces(force[free]) > 0.1 * size:
            matrices += 1
            if matrices > MAXIMUM_MATRICES and _norm_of_forces(force[free]) > 0.5 * before:
                if settled:
                    return make_pencil(bed, at)
                break
            before = _norm_of_forces(force[free])
            pencil, fresh = make_pencil(bed, at), True
    raise InputError(
        f"no equilibrium was found near the start: forces of {_norm_of_forces(force[free]):.3g} N remain; "
        "start from a run that has come to rest"
    )


def _forces_or_infinite(bed: BedForces, at: Float[np.ndarray, "q"]) -> Float[np.ndarray, "q"]:
    """Return the forces [N], or infinite forces if a grain is outside the cell or on another grain."""
    try:
        return bed.forces(at)
    except InputError:
        return np.full(bed.size, np.inf)


def _norm_of_forces(forces: np.ndarray) -> float:
    return float(np.abs(forces).max(initial=0.0))


def coordinates_to_pin_in_periodic_cell(bed: BedForces) -> tuple[int, ...]:
    """Return the coordinates of a grain to hold in a periodic cell, where all grains could shift together."""
    return () if bed.scene.cell.periods is None else (0, bed.grains)
