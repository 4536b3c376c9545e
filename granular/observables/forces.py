"""Forces on the piston, the walls and the grains; stresses of grains, and how forces are spread."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.observables.frame import (
    Frame,
    Observable,
    check_grain_values,
    check_vectors,
    labelled_array,
    species_names,
)
from granular.observables.interactions import iterate_pair_forces, iterate_wall_forces
from granular.observables.statistics import DipTest, Histogram, dip_test, knuth_histogram
from granular.observables.voronoi import VoronoiCells, check_cells, voronoi_cells
from granular.schema.cell import Heights, piston_wall_key
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray
    from jaxtyping import Float

    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene


def piston_force(run: Trajectory) -> xarray.DataArray:
    """Force of the grains on the piston, upwards, at every record of a run [N, s]."""
    if "piston_force" not in run.dataset:
        raise InputError(
            f"scene {run.scene.name!r} records no piston force; give it a piston and "
            f"{piston_wall_key(run.scene.cell.lines)}"
        )
    return run.dataset["piston_force"]


def wall_forces(run: Trajectory) -> xarray.DataArray:
    """Force of the grains on every wall that acts, outwards.

    Parameters
    ----------
    run : Trajectory
        Finished run, or one that was cut off.

    Returns
    -------
    xarray.DataArray
        Force on each wall [N], positive outwards, on ``time`` [s] and ``wall``: the names of
        sides that are walls, and piston.

    Raises
    ------
    InputError
        If no wall acts in the scene.
    """
    names = (*(line.name for line in run.scene.cell.lines), "piston")
    present = [wall for wall in names if f"{wall}_force" in run.dataset]
    if not present:
        raise InputError(f"scene {run.scene.name!r} has no walls; give it effects.walls")
    values = np.stack([run.dataset[f"{wall}_force"].values for wall in present], axis=1)
    coordinates = {"time": run.dataset["time"], "wall": present}
    label = Observable("wall_forces", "N", "force on the wall, outwards")
    return labelled_array(values, ("time", "wall"), coordinates, label)


def interaction_forces(frame: Frame) -> np.ndarray:
    """Force of grains and walls on each grain.

    These are the frame's forces without weight, and without inertia where the cell is shaken: the
    resulting magnetic force of [D, 4.3.5], and contact where the scene has it. Forces of own fields
    and gradients are left in them.

    Parameters
    ----------
    frame : Frame
        Instant of a run.

    Returns
    -------
    float64 (n, 2)
        Force on each grain [N]; NaN for absent grains.
    """
    return frame.forces - frame.masses[:, None] * outer_acceleration(frame.scene, frame.time)


def outer_acceleration(scene: Scene, time: float) -> Float[np.ndarray, "2"]:
    """Acceleration by weight, and by inertia in a shaken cell [m/s^2]; time [s]."""
    acceleration, effects = np.zeros(2), scene.effects
    gravity, shaking, host = effects.gravity, effects.shaking, effects.host
    if gravity is not None:
        # A host that carries the piston has the cell upside down.
        upwards = host is not None and host.mount == "piston"
        acceleration[1] += gravity.acceleration if upwards else -gravity.acceleration
    if shaking is not None:
        omega = 2.0 * np.pi * shaking.frequency
        swing = shaking.amplitude * omega**2 * np.sin(omega * time)
        acceleration += swing * np.array([np.cos(shaking.angle), np.sin(shaking.angle)])
    return acceleration


def compressive_forces(scene: Scene, positions: np.ndarray, piston_height: Heights = None) -> np.ndarray:
    """Sum of the magnitudes of all forces of other grains and of walls on each grain.

    De Paula writes it apart from the resulting force (``comPart`` and ``forPart``) and draws its
    distribution [D, 4.3.5, Fig. 5.3, Appendix B]. In a bed at rest the resulting force is what
    friction holds, some hundredths of it. Forces are those of dipoles or discs, of contact without its
    dashpot, and of walls; each grain meets the nearest image of every other one in a periodic cell.

    Parameters
    ----------
    scene : Scene
        Scene that the grains belong to.
    positions : float (n, 2)
        Positions of the grains within the cell [m]; NaN for absent grains.
    piston_height : float, optional
        Height of the piston [m]; the scene's where not given.

    Returns
    -------
    float64 (n,)
        Compressive force [N]; NaN for absent grains, and for all that stand at one point or meet a piston
        whose height is NaN.

    Raises
    ------
    InputError
        If the shape is not that of the scene's grains, or an effect acts between grains by another law
        than dipole and contact (``pair_law``, an own effect).
    """
    total = np.full(len(check_vectors(positions)), np.nan)
    for some in iterate_pair_forces(scene, positions):
        total[some.grains] = np.linalg.norm(some.forces, axis=2).sum(axis=1)
    walls = iterate_wall_forces(scene, positions, piston_height)
    total[walls.grains] += np.linalg.norm(walls.forces, axis=2).sum(axis=1)
    return total


def relative_force_fluctuation(magnitudes: np.ndarray, species: np.ndarray) -> np.ndarray:
    """Relative fluctuation |F_k - mean F|/mean F, with the mean over the species of grain k [D, eq. 4.35].

    Parameters
    ----------
    magnitudes : float (n,)
        Magnitudes of the forces on the grains [N], 0 or more; NaN for grains that are not to count.
    species : int (n,)
        Index of each grain's species.

    Returns
    -------
    float64 (n,)
        Fluctuation without unit; NaN for grains whose magnitude is not finite, and where the mean of their
        species is not above 0.

    Raises
    ------
    InputError
        If magnitudes or species have another shape than (n,), or differ in it.
    """
    magnitudes = np.asarray(magnitudes, dtype=np.float64)
    magnitudes = check_grain_values("magnitudes", magnitudes, magnitudes.size)
    species = check_grain_values("species", species, len(magnitudes))
    fluctuation = np.full(len(magnitudes), np.nan)
    for specy in np.unique(species):
        chosen = (species == specy) & np.isfinite(magnitudes)
        mean = magnitudes[chosen].mean() if chosen.any() else 0.0
        if mean > 0.0:
            fluctuation[chosen] = np.abs(magnitudes[chosen] - mean) / mean
    return fluctuation


def grain_virials(scene: Scene, positions: np.ndarray, piston_height: Heights = None) -> np.ndarray:
    """Virial of each grain: sum of branch times force, half for a pair and whole for a wall.

    The branch of a pair belongs to both grains, that of a wall to one alone. So the sum over all
    grains is that of the bed: with every grain at rest its yy component is the piston force times
    the piston's height, plus what weight and friction hold (the virial theorem; Allen and Tildesley,
    Computer Simulation of Liquids, 2nd ed. 2017). Forces are those of `compressive_forces`.

    Parameters
    ----------
    scene : Scene
        Scene that the grains belong to.
    positions : float (n, 2)
        Positions of the grains within the cell [m]; NaN for absent grains.
    piston_height : float, optional
        Height of the piston [m]; the scene's where not given.

    Returns
    -------
    float64 (n, 2, 2)
        Virial [J], positive where the grain is pressed; NaN for absent grains, and for all that stand at
        one point or meet a piston whose height is NaN.

    Raises
    ------
    InputError
        If the shape is not that of the scene's grains, or an effect acts between grains by another law
        than dipole and contact (``pair_law``, an own effect).
    """
    virials = np.full((len(check_vectors(positions)), 2, 2), np.nan)
    for some in iterate_pair_forces(scene, positions):
        virials[some.grains] = 0.5 * np.einsum("kmi,kmj->kij", some.branches, some.forces)
    walls = iterate_wall_forces(scene, positions, piston_height)
    virials[walls.grains] += np.einsum("kmi,kmj->kij", walls.branches, walls.forces)
    return virials


def grain_stresses(
    scene: Scene, positions: np.ndarray, piston_height: Heights = None, cells: VoronoiCells | None = None
) -> np.ndarray:
    """Virial stress tensor of each grain: `grain_virials` over the area of its Voronoi cell.

    It is the virial stress in two dimensions (Irving and Kirkwood, J. Chem. Phys. 18, 817, 1950),
    without its kinetic part.

    Parameters
    ----------
    scene : Scene
        Scene that the grains belong to.
    positions : float (n, 2)
        Positions of the grains within the cell [m]; NaN for absent grains.
    piston_height : float, optional
        Height of the piston [m]; the scene's where not given.
    cells : VoronoiCells, optional
        Voronoi cells of these positions, where they are known already.

    Returns
    -------
    float64 (n, 2, 2)
        Stress [N/m], positive for compression; NaN for grains without an interior Voronoi cell, and where
        `grain_virials` is.

    Raises
    ------
    InputError
        If the positions have another shape than the scene's grains, the cells are of another number of
        grains, or an effect acts between grains by another law than dipole and contact (``pair_law``, an
        own effect).
    """
    _, cells = check_cells(scene.cell.wrap_positions(positions), cells)
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
        Height of the piston [m]; the scene's where not given.
    cells : VoronoiCells, optional
        Voronoi cells of these positions, where they are known already.

    Returns
    -------
    float64 (n,)
        Pressure of each grain [N/m], positive for compression; NaN where `grain_stresses` is.

    Raises
    ------
    InputError
        If the positions have another shape than the scene's grains, the cells are of another number of
        grains, or an effect acts between grains by another law than dipole and contact (``pair_law``, an
        own effect).
    """
    stresses = grain_stresses(scene, positions, piston_height, cells)
    return np.asarray(0.5 * np.trace(stresses, axis1=1, axis2=2))


def force_distribution(frame: Frame, *, pooled: bool = False) -> dict[str, Histogram]:
    """Histograms of the compressive force on the grains of a frame [D, Fig. 4.21].

    Only grains with an interior Voronoi cell count, as in de Paula's pictures of forces; bins are those of
    `knuth_histogram`.

    Parameters
    ----------
    frame : Frame
        Instant of a run; see `frame_at`.
    pooled : bool
        All species in one histogram, named ``"all"``, over the greatest force of the frame, as the
        source draws them.

    Returns
    -------
    dict of str to Histogram
        By the name of the species, for the species that have such grains there; forces in N, or
        over their greatest where they are pooled.

    Raises
    ------
    InputError
        If there is no such grain, or a force that cannot be taken apart (see `compressive_forces`).
    """
    forces = _interior_compressive_forces(frame)
    known = np.isfinite(forces)
    if not known.any():
        raise InputError(
            f"the frame at {frame.time:g} s has 0 grains with an interior Voronoi cell; give one "
            "whose grains lie in more than two rows"
        )
    if pooled:
        return {"all": knuth_histogram(forces[known] / forces[known].max())}
    return {
        name: knuth_histogram(forces[known & (frame.species == k)])
        for k, name in enumerate(species_names(frame.scene))
        if (known & (frame.species == k)).any()
    }


def force_dip_test(frame: Frame) -> DipTest:
    """Test the compressive forces of a frame, of all species together, for more than one mode.

    The dip test of Hartigan and Hartigan (Ann. Stat. 13, 70, 1985), over the grains that have an
    interior Voronoi cell.

    Parameters
    ----------
    frame : Frame
        Instant of a run.

    Returns
    -------
    DipTest
        Dip of the distribution and its probability under one mode, without unit.

    Raises
    ------
    InputError
        If fewer than four grains have an interior cell, or a force cannot be taken apart (see
        `compressive_forces`).
    """
    return dip_test(_interior_compressive_forces(frame))


def _interior_compressive_forces(frame: Frame) -> np.ndarray:
    """Compressive forces of the grains with an interior cell (n,) [N]; NaN for the others."""
    forces = compressive_forces(frame.scene, frame.positions, frame.heights)
    return np.where(voronoi_cells(frame.positions).interior, forces, np.nan)
