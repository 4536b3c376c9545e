"""Forces on the piston, the walls and the grains, stresses of the grains, and distributions of forces.

The force on each grain is resolved into the forces of single pairs and walls. Dipoles, discs, contacts
(without their dashpots) and walls are implemented. All pairs are summed, even if the run used a cut-off or a
mesh. In a periodic cell each grain interacts with the nearest image of every other grain.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.effects.dipole import discs_unless_dipoles
from granular.effects.wall_side import add_wall_forces
from granular.observables.frame import (
    Frame,
    Observable,
    checked_grain_values,
    checked_vectors,
    labelled_array,
    present_grain_mask,
    species_names,
)
from granular.observables.statistics import DipTest, Histogram, dip_test, knuth_histogram
from granular.observables.voronoi import VoronoiCells, checked_positions_and_cells, voronoi_cells
from granular.pairs.dipole_law import STRENGTH
from granular.pairs.disc_law import Disc, contact_distance, disc_energy_and_force, pair_squared_distance_shift
from granular.scene.bed_drawing import body_index_of_side
from granular.schema.cell import Heights, piston_wall_key
from granular.shared.array_types import Float, Int
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene


# The vectors of 512 grains take 50 MB with 6,000 grains.
BLOCK = 512
"""Number of grains whose pairs are held in memory at the same time."""

SERIES_DISTANCE = 20.0
"""Distance, in contact distances, beyond which only the first term of the series for discs is kept."""

KNOWN = ("dipole", "contact", "walls")
SILENT = (
    *("bath", "drag", "eddy", "field", "friction"),
    *("gradient", "gravity", "host", "shaking", "wall_friction"),
)
"""Effects that exert no force between grains or between grains and walls."""


class BranchesAndForces(NamedTuple):
    """Branch vectors from other grains or walls to k grains, and the forces of these bodies on the grains."""

    grains: Int[np.ndarray, "k"]  # indices of the grains on which the forces act
    branches: Float[np.ndarray, "k m 2"]  # from each of the m other bodies to each of these grains [m]
    forces: Float[np.ndarray, "k m 2"]  # on these grains [N]


def effects_of_unknown_pair_force(scene: Scene) -> tuple[str, ...]:
    """Names of a scene's effects whose forces between grains cannot be resolved into pair forces."""
    return tuple(effect.key for effect in scene.effects.acting if effect.key not in (*KNOWN, *SILENT))


def iterate_pair_forces(scene: Scene, positions: Float[np.ndarray, "n 2"]) -> Iterator[BranchesAndForces]:
    """Yield, for k grains at a time, branch vectors (k, m, 2) [m] and forces [N] of all m grains on them."""
    positions, present, system = _positions_and_scene_in_natural_units(scene, positions)
    scales = system.scales
    points = positions[present]
    moments = relative_magnetic_moments(scene)[present]
    laws = zip(system.effects, system.constants.acting.laws, strict=True)
    contact = next((law for effect, law in laws if effect.key == "contact"), None)
    discs, species = (
        discs_unless_dipoles(scene.grains, scales.length),
        scene.grains.species_indices()[present],
    )
    for start in range(0, len(present), BLOCK):
        block = np.arange(start, min(start + BLOCK, len(present)))
        branch = scene.cell.nearest_image_displacements(points[block, None] - points[None]) / scales.length
        r = np.linalg.norm(branch, axis=2)
        r[np.arange(len(block)), block] = np.inf
        push = np.zeros_like(r)
        if scene.effects.dipole is not None:
            push += STRENGTH * moments[block][:, None] * moments[None] / r**4
            if discs:
                push *= _disc_to_dipole_force_ratio(discs, r, species[block], species)
        if contact is not None:
            push += _contact_pair_forces(contact, r, present[block], present)
        with np.errstate(invalid="ignore"):
            forces = (push / r)[:, :, None] * branch
        yield BranchesAndForces(present[block], branch * scales.length, forces * scales.force)


def wall_branches_and_forces(
    scene: Scene, positions: Float[np.ndarray, "n 2"], piston_height: Heights = None
) -> BranchesAndForces:
    """Evaluate branch vectors (k, m, 2) [m] and forces [N] of the m walls on each of k grains.

    ``piston_height`` is one height [m], or the piston's height followed by the heights of further pistons.
    """
    positions, present, system = _positions_and_scene_in_natural_units(scene, positions)
    scales, points = system.scales, positions[present]
    if piston_height is None:
        piston_height = np.nan if scene.piston is None else scene.piston.height
    heights = np.array([0.0, *np.atleast_1d(piston_height)])
    sides = zip(scene.cell.lines, system.constants.acting.sides, strict=True)
    acting = [(line, side) for line, side in sides if side.law is not None]
    moments, (x, y) = relative_magnetic_moments(scene)[present], np.array(points.T / scales.length)
    branches, forces = np.zeros((2, len(present), len(acting), 2))
    for k, (line, side) in enumerate(acting):
        law = side.law
        if getattr(law, "species", None) is not None:
            law = law._replace(species=system.species[present])
        pushes, wall_side = np.zeros((3, len(present))), side._replace(law=law)
        body = body_index_of_side(scene, line)
        if body >= len(heights):
            raise InputError(
                f"side {line.name!r} moves with a further piston; pass the height of this piston after the "
                "height of the first piston"
            )
        add_wall_forces(wall_side, x, y, heights[body] / scales.length, moments, pushes)
        distances = line.distances_from_side(points - [0.0, heights[body]], 0.0)
        branches[:, k] = distances[:, None] * line.normal
        forces[:, k] = pushes[:2].T
    return BranchesAndForces(present, branches, forces * scales.force)


def _positions_and_scene_in_natural_units(
    scene: Scene, positions: np.ndarray
) -> tuple[np.ndarray, np.ndarray, Any]:
    """Check positions; return them, the indices of the present grains, and the scene in natural units."""
    from granular.scene.scene_in_natural_units import scene_in_natural_units

    positions = checked_vectors(positions)
    if len(positions) != scene.grains.count:
        raise InputError(
            f"{len(positions)} positions for {scene.grains.count} grains; pass one position for each grain"
        )
    if unresolved := effects_of_unknown_pair_force(scene):
        raise InputError(
            f"effects.{unresolved[0]}: the force of this effect between grains cannot be resolved into "
            "pairs; use the resultant force instead"
        )
    return positions, np.flatnonzero(present_grain_mask(positions)), scene_in_natural_units(scene)


def relative_magnetic_moments(scene: Scene) -> Float[np.ndarray, "n"]:
    """Magnetic moment of each grain relative to the first species."""
    grains = scene.grains
    return np.asarray(grains.moment_ratios()[grains.species_indices()] * grains.moment_spread_factors())


def _disc_to_dipole_force_ratio(
    discs: tuple[Disc, ...], r: np.ndarray, first: np.ndarray, second: np.ndarray
) -> np.ndarray:
    """Ratio of disc force to dipole force between discs of the species ``first`` and ``second``."""
    result = np.ones_like(r)
    for i, j in itertools.product(range(len(discs)), repeat=2):
        pair_block = np.ix_(first == i, second == j)
        result[pair_block] = _make_disc_to_dipole_ratio(discs[i], discs[j])(r[pair_block])
    return result


@cache
def _make_disc_to_dipole_ratio(first: Disc, second: Disc) -> Callable[[np.ndarray], np.ndarray]:
    """Ratio of disc force to dipole force as a function of distance; linear below contact."""
    from scipy.interpolate import CubicSpline

    from granular.pairs.disc_law import force_slope_at_contact

    contact, shift = contact_distance(first, second), pair_squared_distance_shift(first, second)
    # The singular part at contact is smooth in the square root of the gap.
    root_gaps = np.linspace(0.0, np.sqrt((SERIES_DISTANCE - 1.0) * contact), 400)
    distances = contact + root_gaps**2
    spline = CubicSpline(root_gaps, disc_energy_and_force(distances, first, second)[1] * distances**4 / 3.0)
    slope = force_slope_at_contact(first, second) / 3.0

    def force_ratio(r: np.ndarray) -> np.ndarray:
        gap = r - contact
        near = spline(np.sqrt(np.clip(gap, 0.0, root_gaps[-1] ** 2)))
        far = 1.0 + 2.5 * shift / r**2
        pressed = (spline(0.0) / contact**4 + slope * np.minimum(gap, 0.0)) * np.minimum(r, contact) ** 4
        return np.where(gap < 0.0, pressed, np.where(gap < root_gaps[-1] ** 2, near, far))

    return force_ratio


def _contact_pair_forces(law: Any, r: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    from granular.effects import contact

    push = np.zeros_like(r)
    overlap = law.radius[first][:, None] + law.radius[second][None] - r
    for i, j in np.argwhere(overlap > 0.0):
        spring = _callable_kernel(contact.hertz_spring_constant)(
            law, law.radius[first[i]], law.radius[second[j]]
        )
        push[i, j] = _callable_kernel(contact.hertz_force)(spring, overlap[i, j])
    return push


@cache
def _callable_kernel(kernel: Any) -> Any:
    """Return a compiled kernel in a form that Python can call."""
    from granular.compiled import entry

    return entry(kernel)


def piston_force(run: Trajectory) -> xarray.DataArray:
    """Upward force [N] of the grains on the piston as a function of the recorded times [s] of a run."""
    if "piston_force" not in run.dataset:
        raise InputError(
            f"scene {run.scene.name!r} records no piston force; add a piston and "
            f"{piston_wall_key(run.scene.cell.lines)}"
        )
    return run.dataset["piston_force"]


def wall_forces(run: Trajectory) -> xarray.DataArray:
    """Outward force of the grains on every active wall.

    Parameters
    ----------
    run : Trajectory
        Finished or interrupted run.

    Returns
    -------
    xarray.DataArray
        Force on each wall [N], positive outwards, with the dimensions ``time`` [s] and ``wall``: the names of
        the sides that are walls, and the piston.

    Raises
    ------
    InputError
        If the scene has no active wall.
    """
    names = (*(line.name for line in run.scene.cell.lines), "piston")
    present = [wall for wall in names if f"{wall}_force" in run.dataset]
    if not present:
        raise InputError(f"scene {run.scene.name!r} has no walls; add effects.walls")
    values = np.stack([run.dataset[f"{wall}_force"].values for wall in present], axis=1)
    coordinates = {"time": run.dataset["time"], "wall": present}
    label = Observable("wall_forces", "N", "force on the wall, outwards")
    return labelled_array(values, ("time", "wall"), coordinates, label)


def interaction_forces(frame: Frame) -> np.ndarray:
    """Force of grains and walls on each grain.

    These are the frame's forces without weight and without the inertia of a shaken cell. They consist of the
    resultant magnetic force of [D, 4.3.5], contact forces, and the forces of user-defined fields and
    gradients.

    Parameters
    ----------
    frame : Frame
        Instant of a run.

    Returns
    -------
    float64 (n, 2)
        Force on each grain [N]; NaN for absent grains.
    """
    return frame.forces - frame.masses[:, None] * acceleration_by_weight_and_shaking(frame.scene, frame.time)


def acceleration_by_weight_and_shaking(scene: Scene, time: float) -> Float[np.ndarray, "2"]:
    """Acceleration [m/s^2] due to weight and, in a shaken cell, to inertia at a time [s]."""
    acceleration, effects = np.zeros(2), scene.effects
    gravity, shaking, host = effects.gravity, effects.shaking, effects.host
    if gravity is not None:
        # If the host (the structure that carries the damper) holds the piston, the cell is upside down.
        upwards = host is not None and host.mount == "piston"
        acceleration[1] += gravity.acceleration if upwards else -gravity.acceleration
    if shaking is not None:
        omega = 2.0 * np.pi * shaking.frequency
        inertia = shaking.amplitude * omega**2 * np.sin(omega * time)
        acceleration += inertia * np.array([np.cos(shaking.angle), np.sin(shaking.angle)])
    return acceleration


def compressive_forces(scene: Scene, positions: np.ndarray, piston_height: Heights = None) -> np.ndarray:
    """Sum of the magnitudes of all forces that other grains and walls exert on each grain.

    De Paula calls this sum the compressive force (``comPart``), distinguishes it from the resultant force
    (``forPart``), and shows its distribution [D, 4.3.5, Fig. 5.3, Appendix B]. In a bed at rest the resultant
    force is balanced by friction and is a few hundredths of the compressive force. Forces of dipoles or
    discs, of contact without its dashpot, and of walls are included. In a periodic cell each grain interacts
    with the nearest image of every other grain.

    Parameters
    ----------
    scene : Scene
        Scene that the grains belong to.
    positions : float (n, 2)
        Positions of the grains within the cell [m]; NaN for absent grains.
    piston_height : float, optional
        Height of the piston [m]; if not given, the height in the scene.

    Returns
    -------
    float64 (n,)
        Compressive force [N]; NaN for absent grains, for grains at the same point, and for grains that
        interact with a piston whose height is NaN.

    Raises
    ------
    InputError
        If the shape does not match the scene's grains, or an effect exerts forces between grains other than
        dipole and contact forces (``pair_law``, a user-defined effect).
    """
    total = np.full(len(checked_vectors(positions)), np.nan)
    for block in iterate_pair_forces(scene, positions):
        total[block.grains] = np.linalg.norm(block.forces, axis=2).sum(axis=1)
    walls = wall_branches_and_forces(scene, positions, piston_height)
    total[walls.grains] += np.linalg.norm(walls.forces, axis=2).sum(axis=1)
    return total


def relative_force_fluctuation(magnitudes: np.ndarray, species: np.ndarray) -> np.ndarray:
    """Relative fluctuation |F_k - mean F|/mean F, with the mean over the species of grain k [D, eq. 4.35].

    Parameters
    ----------
    magnitudes : float (n,)
        Magnitudes of the forces on the grains [N], 0 or more; NaN for grains to be ignored.
    species : int (n,)
        Index of each grain's species.

    Returns
    -------
    float64 (n,)
        Dimensionless fluctuation; NaN for grains whose magnitude is not finite, and for species whose mean
        magnitude is 0.

    Raises
    ------
    InputError
        If magnitudes and species do not have the same shape (n,).
    """
    magnitudes = np.asarray(magnitudes, dtype=np.float64)
    magnitudes = checked_grain_values("magnitudes", magnitudes, magnitudes.size)
    species = checked_grain_values("species", species, len(magnitudes))
    fluctuation = np.full(len(magnitudes), np.nan)
    for specy in np.unique(species):
        chosen = (species == specy) & np.isfinite(magnitudes)
        mean = magnitudes[chosen].mean() if chosen.any() else 0.0
        if mean > 0.0:
            fluctuation[chosen] = np.abs(magnitudes[chosen] - mean) / mean
    return fluctuation


def grain_virials(scene: Scene, positions: np.ndarray, piston_height: Heights = None) -> np.ndarray:
    """Virial of each grain: sum of (branch vector) times (force), halved for pairs but not for walls.

    The branch vector of a pair is shared by two grains; the branch vector of a wall belongs to one grain. The
    sum over all grains is therefore the virial of the bed. If all grains are at rest, the yy component of the
    bed's virial is the piston force times the piston's height, plus contributions of weight and friction (the
    virial theorem; Allen and Tildesley, Computer Simulation of Liquids, 2nd ed. 2017). The forces are the
    same as in `compressive_forces`.

    Parameters
    ----------
    scene : Scene
        Scene that the grains belong to.
    positions : float (n, 2)
        Positions of the grains within the cell [m]; NaN for absent grains.
    piston_height : float, optional
        Height of the piston [m]; if not given, the height in the scene.

    Returns
    -------
    float64 (n, 2, 2)
        Virial [J], positive under compression; NaN for absent grains, for grains at the same point, and for
        grains that interact with a piston whose height is NaN.

    Raises
    ------
    InputError
        If the shape does not match the scene's grains, or an effect exerts forces between grains other than
        dipole and contact forces (``pair_law``, a user-defined effect).
    """
    virials = np.full((len(checked_vectors(positions)), 2, 2), np.nan)
    for block in iterate_pair_forces(scene, positions):
        virials[block.grains] = 0.5 * np.einsum("kmi,kmj->kij", block.branches, block.forces)
    walls = wall_branches_and_forces(scene, positions, piston_height)
    virials[walls.grains] += np.einsum("kmi,kmj->kij", walls.branches, walls.forces)
    return virials


def grain_stresses(
    scene: Scene, positions: np.ndarray, piston_height: Heights = None, cells: VoronoiCells | None = None
) -> np.ndarray:
    """Virial stress tensor of each grain: `grain_virials` divided by the area of its Voronoi cell.

    The kinetic part of the two-dimensional virial stress is not included (Irving and Kirkwood, J. Chem. Phys.
    18, 817, 1950).

    Parameters
    ----------
    scene : Scene
        Scene that the grains belong to.
    positions : float (n, 2)
        Positions of the grains within the cell [m]; NaN for absent grains.
    piston_height : float, optional
        Height of the piston [m]; if not given, the height in the scene.
    cells : VoronoiCells, optional
        Voronoi cells of these positions, if already computed.

    Returns
    -------
    float64 (n, 2, 2)
        Stress [N/m], positive for compression; NaN for grains without an interior Voronoi cell, and for
        grains whose `grain_virials` are NaN.

    Raises
    ------
    InputError
        If the positions do not match the scene's grains, ``cells`` has another number of grains, or an effect
        exerts forces between grains other than dipole and contact forces (``pair_law``, a user-defined
        effect).
    """
    _, cells = checked_positions_and_cells(scene.cell.wrap_positions(positions), cells)
    return grain_virials(scene, positions, piston_height) / cells.area[:, None, None]


def grain_pressures(
    scene: Scene, positions: np.ndarray, piston_height: Heights = None, cells: VoronoiCells | None = None
) -> np.ndarray:
    """Virial pressure of each grain in two dimensions: half the trace of `grain_stresses`.

    (Irving and Kirkwood, J. Chem. Phys. 18, 817, 1950.)

    Parameters
    ----------
    scene : Scene
        Scene that the grains belong to.
    positions : float (n, 2)
        Positions of the grains within the cell [m]; NaN for absent grains.
    piston_height : float, optional
        Height of the piston [m]; if not given, the height in the scene.
    cells : VoronoiCells, optional
        Voronoi cells of these positions, if already computed.

    Returns
    -------
    float64 (n,)
        Pressure of each grain [N/m], positive for compression; NaN if the grain's `grain_stresses` are NaN.

    Raises
    ------
    InputError
        If the positions do not match the scene's grains, ``cells`` has another number of grains, or an effect
        exerts forces between grains other than dipole and contact forces (``pair_law``, a user-defined
        effect).
    """
    stresses = grain_stresses(scene, positions, piston_height, cells)
    return np.asarray(0.5 * np.trace(stresses, axis1=1, axis2=2))


def force_distribution(frame: Frame, *, pooled: bool = False) -> dict[str, Histogram]:
    """Histograms of the compressive force on the grains of a frame [D, Fig. 4.21].

    Only grains with an interior Voronoi cell are included, as in de Paula's figures of forces.
    `knuth_histogram` chooses the bins.

    Parameters
    ----------
    frame : Frame
        Instant of a run; see `frame_at`.
    pooled : bool
        If true, all species are in one histogram, named ``"all"``, with forces divided by the maximum force
        of the frame, as in [D].

    Returns
    -------
    dict of str to Histogram
        Histogram of each species that has grains with an interior cell, by species name. Forces are in N; if
        pooled, they are divided by the maximum force and dimensionless.

    Raises
    ------
    InputError
        If no grain has an interior cell, or a force cannot be resolved into pairs (see `compressive_forces`).
    """
    forces = _interior_compressive_forces(frame)
    known = np.isfinite(forces)
    if not known.any():
        raise InputError(
            f"the frame at {frame.time:g} s has 0 grains with an interior Voronoi cell; use a "
            "frame whose grains lie in more than two rows"
        )
    if pooled:
        return {"all": knuth_histogram(forces[known] / forces[known].max())}
    return {
        name: knuth_histogram(forces[known & (frame.species == k)])
        for k, name in enumerate(species_names(frame.scene))
        if (known & (frame.species == k)).any()
    }


def force_dip_test(frame: Frame) -> DipTest:
    """Test whether the distribution of a frame's compressive forces, all species together, has several peaks.

    The dip test of Hartigan and Hartigan (Ann. Stat. 13, 70, 1985) is applied to the grains that have an
    interior Voronoi cell.

    Parameters
    ----------
    frame : Frame
        Instant of a run.

    Returns
    -------
    DipTest
        Dip of the distribution, and the p-value: the probability of a dip this large if the distribution has
        one peak. Both are dimensionless.

    Raises
    ------
    InputError
        If fewer than four grains have an interior cell, or a force cannot be resolved into pairs (see
        `compressive_forces`).
    """
    return dip_test(_interior_compressive_forces(frame))


def _interior_compressive_forces(frame: Frame) -> np.ndarray:
    """Compressive forces (n,) [N] of the grains with an interior cell; NaN for the others."""
    forces = compressive_forces(frame.scene, frame.positions, frame.heights)
    return np.where(voronoi_cells(frame.positions).interior, forces, np.nan)
