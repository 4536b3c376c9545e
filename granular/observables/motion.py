"""Motion of grains: temperature, functions of the lag between frames, Lindemann parameter, D2min."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.observables.forces import (
    iterate_pair_forces,
    relative_magnetic_moments,
    wall_branches_and_forces,
)
from granular.observables.frame import (
    Observable,
    checked_frames,
    checked_grain_values,
    checked_or_default_lags,
    checked_period_lengths,
    checked_vectors,
    labelled_array,
    observable,
    observable_metadata,
    present_grain_mask,
    select_frame_indices,
    sum_by_index,
)
from granular.observables.moduli import dipole_pair_strength, magnetic_moment_of_first_species
from granular.observables.voronoi import voronoi_cells
from granular.shared.array_types import Float
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene


MAXIMUM_UNEVENNESS = 1e-6
"""Maximum difference between the time intervals of successive frames, relative to their mean."""


def per_lag(
    run: Trajectory, function: Callable[..., np.ndarray], start: float = 0.0, stop: float = np.inf
) -> xarray.DataArray:
    """Evaluate a function of the lag (the time between two frames) for the frames with start <= time <= stop.

    Parameters
    ----------
    run : Trajectory
        Finished or interrupted run.
    function : function of frames (f, n, 2) [m] and lags (k,)
        `mean_square_displacement`, `non_gaussian_parameter`, `lindemann_parameter` or `bond_relaxation`, or a
        user-defined function. Positions are not wrapped into a periodic cell; a function with the argument
        ``periods`` receives the cell's sides.
    start, stop : float
        First and last time of the frames [s].

    Returns
    -------
    xarray.DataArray
        Values (k,) at about 30 logarithmically spaced lags, with the coordinate ``lag`` [s]; NaN if the
        function returns NaN. Unit and meaning are attached if the function is an `observable`.

    Raises
    ------
    InputError
        If the function raises this error, fewer than two frames lie in the range, or these frames are not
        evenly spaced in time.
    """
    chosen = select_frame_indices(run, start, stop)
    frames = checked_frames(run.dataset["position"].values[chosen], minimum_count=2)
    steps = np.diff(run.dataset["frame_time"].values[chosen])
    if np.ptp(steps) > MAXIMUM_UNEVENNESS * len(steps) * steps.mean():
        raise InputError(
            f"the time between frames varies from {steps.min():.3g} to {steps.max():.3g} s; choose start "
            "and stop within one stage of evenly spaced frames"
        )
    lags, options = checked_or_default_lags(None, len(frames)), {}
    if "periods" in inspect.signature(function).parameters:
        options["periods"] = run.scene.cell.periods
    coordinates = {"lag": ("lag", lags * steps.mean(), {"units": "s"})}
    values = np.asarray(function(frames, lags, **options))
    return labelled_array(values, "lag", coordinates, observable_metadata(function))


@observable("m^2", "mean square displacement")
def mean_square_displacement(frames: np.ndarray, lags: np.ndarray | None = None) -> np.ndarray:
    """Mean square displacement <|r(t) - r(0)|^2> over grains and frames.

    All pairs of frames separated by the lag are used (Allen and Tildesley, Computer Simulation of Liquids,
    2nd ed. 2017).

    Parameters
    ----------
    frames : float (f, n, 2)
        Positions of the grains in each frame [m], not wrapped into a periodic cell; NaN for absent grains.
    lags : int (k,), optional
        Lags in frames, 1 to f - 1; about 30, spaced logarithmically, if not given.

    Returns
    -------
    float64 (k,)
        Mean square displacement at each lag [m^2].

    Raises
    ------
    InputError
        If a shape or lag is invalid, there are fewer than two frames, or at some lag no grain is present in
        both frames.
    """
    frames = checked_frames(frames, minimum_count=2)
    means = []
    for lag in checked_or_default_lags(lags, len(frames)):
        squares = ((frames[lag:] - frames[:-lag]) ** 2).sum(axis=2)
        squares = squares[np.isfinite(squares)]
        if not len(squares):
            raise InputError(
                f"at a lag of {lag} frames, no grain is present in both frames; use shorter lags"
            )
        means.append(squares.mean())
    return np.array(means)


@observable("1", "dynamic Lindemann parameter")
def lindemann_parameter(
    frames: np.ndarray, lags: np.ndarray | None = None, periods: tuple[float, float] | None = None
) -> np.ndarray:
    """Lindemann parameter gamma(t) = <|du_i(t) - du_j(t)|^2>/(2 a^2), averaged over neighbours i and j.

    Here du is the displacement of a grain in the time t, and a is the spacing of the hexagonal lattice with
    the mean cell area. The average is over Voronoi neighbours in the earlier frame; both must have an
    interior cell. The parameter stays finite in a two-dimensional crystal, unlike the mean square
    displacement (Zahn, Lenke and Maret, Phys. Rev. Lett. 82, 2721, 1999). In layers of dipoles the parameter
    stays below 0.033 up to melting (Zahn and Maret, Phys. Rev. Lett. 85, 3656, 2000).

    Parameters
    ----------
    frames : float (f, n, 2)
        Positions of the grains in each frame [m]; NaN for absent grains.
    lags : int (k,), optional
        Lags in frames, 1 to f - 1; about 30, spaced logarithmically, if not given.
    periods : (float, float), optional
        Sides of a periodic cell [m], above 0; neighbours are sought within the cell. Pass positions that are
        not wrapped into the cell.

    Returns
    -------
    float64 (k,)
        Parameter at each lag, dimensionless.

    Raises
    ------
    InputError
        If a shape, lag or period is invalid, there are fewer than two frames, or at some lag no two
        neighbours with interior cells are present in both frames.
    """
    frames = checked_frames(frames, minimum_count=2)
    sides = None if periods is None else checked_period_lengths(periods)
    lags = checked_or_default_lags(lags, len(frames))
    total, number = np.zeros((2, len(lags)))
    areas = []
    for first, start in enumerate(frames[:-1]):
        cells = voronoi_cells(start if sides is None else np.mod(start, sides))
        i, j = cells.neighbours[cells.interior[cells.neighbours].all(axis=1)].T
        areas.append(cells.area[cells.interior])
        for k, lag in enumerate(lags):
            if first + lag < len(frames):
                displacement = frames[first + lag] - start
                square = ((displacement[i] - displacement[j]) ** 2).sum(axis=1)
                known = np.isfinite(square)
                total[k] += square[known].sum()
                number[k] += np.count_nonzero(known)
    area = np.concatenate(areas)
    if not len(area) or not number.all():
        raise InputError(
            "for at least one lag, no pair of neighbours away from the boundary is present in both frames; "
            "use a larger bed"
        )
    # 2 a^2, a^2 = (2/sqrt(3)) times the area of a hexagonal cell.
    return np.asarray(total / number / (2.0 * 2.0 / np.sqrt(3.0) * area.mean()))


class NonAffineMotion(NamedTuple):
    """Non-affine motion around each grain between two frames; NaN if undefined."""

    d2min: Float[np.ndarray, "n"]  # mean square residual of the best local strain [m^2]
    strain: Float[np.ndarray, "n 2 2"]  # best local deformation gradient minus 1


def non_affine_motion(first: np.ndarray, second: np.ndarray) -> NonAffineMotion:
    """Non-affine displacement D2min between two frames, for each grain with an interior cell.

    D2min of grain i is the minimum, over all 2 x 2 matrices F, of the average of

        |r_j'' - r_i'' - F (r_j' - r_i')|^2

    over the Voronoi neighbours j in the first frame; ' marks the first and '' the second frame. (Falk and
    Langer, Phys. Rev. E 57, 7192, 1998, take the sum over all grains within a given distance.)

    Parameters
    ----------
    first, second : float (n, 2)
        Positions in both frames [m], not wrapped into a periodic cell in between; NaN for absent grains.

    Returns
    -------
    NonAffineMotion
        D2min [m^2] (n,) and local strain (n, 2, 2), dimensionless; NaN for grains without an interior cell in
        the first frame, for grains absent from the second frame, and for grains with fewer than three
        neighbours in the second frame.

    Raises
    ------
    InputError
        If the positions do not have the shape (n, 2), or the frames differ in their number of grains.
    """
    first, second = checked_vectors(first), checked_vectors(second)
    if first.shape != second.shape:
        raise InputError(
            f"the frames have {len(first)} and {len(second)} grains; use two frames of the same bed"
        )
    cells = voronoi_cells(first)
    directed_pairs = np.concatenate([cells.neighbours, cells.neighbours[:, ::-1]])
    before = first[directed_pairs[:, 1]] - first[directed_pairs[:, 0]]
    after = second[directed_pairs[:, 1]] - second[directed_pairs[:, 0]]
    known = np.isfinite(after).all(axis=1)
    i, before, after = directed_pairs[known, 0], before[known], after[known]
    count = len(first)
    cross_moment = sum_by_index(i, after[:, :, None] * before[:, None, :], count)
    moment = sum_by_index(i, before[:, :, None] * before[:, None, :], count)
    neighbour_count = np.bincount(i, minlength=count)
    # Two bonds have four components, as many as the gradient, which would fit them exactly (D2min = 0).
    solvable = cells.interior & (neighbour_count > 2) & present_grain_mask(second)
    gradient = np.full((count, 2, 2), np.nan)
    gradient[solvable] = np.linalg.solve(
        moment[solvable], cross_moment[solvable].transpose(0, 2, 1)
    ).transpose(0, 2, 1)
    residual = after - np.einsum("jab,jb->ja", gradient[i], before)
    total = np.bincount(i, (residual**2).sum(axis=1), minlength=count)
    d2min = np.where(solvable, total / np.maximum(neighbour_count, 1), np.nan)
    return NonAffineMotion(d2min, gradient - np.eye(2))


def non_affine_series(run: Trajectory, every: int = 1) -> xarray.DataArray:
    """Non-affine displacement D2min of each grain over ``every`` frames; see `non_affine_motion`.

    (Falk and Langer, Phys. Rev. E 57, 7192, 1998.)

    Parameters
    ----------
    run : Trajectory
        Finished or interrupted run.
    every : int
        Index of the second frame minus index of the first frame, 1 or more.

    Returns
    -------
    xarray.DataArray
        D2min [m^2] on (``frame``, ``grain``); NaN in the first ``every`` frames, and if `non_affine_motion`
        returns NaN.

    Raises
    ------
    InputError
        If ``every`` is below 1.
    """
    if every < 1:
        raise InputError(f"every = {every}; 1 frame or more is needed")
    frames = run.dataset["position"].values
    result = np.full(frames.shape[:2], np.nan)
    for k in range(every, len(frames)):
        # Wrap the first frame into a periodic cell, next to its neighbours; displacements are unchanged.
        wrap = run.scene.cell.wrap_positions(frames[k - every]) - frames[k - every]
        result[k] = non_affine_motion(frames[k - every] + wrap, frames[k] + wrap).d2min
    label = Observable("d2min", "m^2", "non-affine motion D2min")
    return labelled_array(result, ("frame", "grain"), {"frame_time": run.dataset["frame_time"]}, label)


def kinetic_temperature(velocities: np.ndarray, masses: np.ndarray) -> float:
    """Kinetic temperature k_B T = (1/2) <m |v - V|^2>, the mean kinetic energy of velocity fluctuations.

    In two dimensions a grain has two degrees of freedom, each with the energy k_B T/2. V is the velocity of
    the centre of mass of the given grains. (Goldhirsch, Annu. Rev. Fluid Mech. 35, 267, 2003, omits the mass;
    with the mass, all species in equilibrium have the same temperature.)

    Parameters
    ----------
    velocities : float (n, 2)
        Velocities v [m/s]; NaN for absent grains.
    masses : float (n,)
        Masses m [kg], above 0.

    Returns
    -------
    float
        Boltzmann's constant times the temperature [J]; NaN without grains.

    Raises
    ------
    InputError
        If shapes do not match, or the mass of a present grain is not above 0.

    Examples
    --------
    >>> import numpy as np
    >>> from granular.observables import kinetic_temperature
    >>> kinetic_temperature(np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([2.0, 2.0]))
    1.0
    """
    velocities = checked_vectors(velocities, "velocities")
    masses = checked_grain_values("masses", masses, len(velocities))
    if not (masses[present_grain_mask(velocities)] > 0.0).all():
        raise InputError("a grain that is present has a mass that is not above 0 kg; correct the masses")
    energies = fluctuation_energies(velocities, masses)
    energies = energies[np.isfinite(energies)]
    return float(energies.mean()) if len(energies) else np.nan


def fluctuation_energies(
    velocities: Float[np.ndarray, "n 2"], masses: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n"]:
    """Energies (1/2) m |v - V|^2 [J]; V is the velocity of the centre of mass (Goldhirsch 2003)."""
    here = present_grain_mask(velocities)
    if not here.any():
        return np.full(len(masses), np.nan)
    drift = np.average(velocities[here], axis=0, weights=masses[here])
    return np.asarray(0.5 * masses * ((velocities - drift) ** 2).sum(axis=1))


KNOWN = ("bath", "dipole", "drag", "eddy", "walls")
WITHOUT_LAPLACIAN = ("friction", "gravity", "shaking")
"""Effects that do not contribute to the Laplacian of the potential."""
# In diameters: central differences then have truncation errors of 1e-10 and rounding errors of 1e-11.
_STEP = 1e-5


def configurational_temperature(
    scene: Scene,
    frames: np.ndarray,
    piston_height: float | np.ndarray | None = None,
    forces: np.ndarray | None = None,
) -> float:
    """Boltzmann's constant times the configurational temperature <|grad U|^2>/<laplacian U> of frames.

    In equilibrium the result equals the kinetic temperature; velocities are not needed (Rugh, Phys. Rev.
    Lett. 78, 772, 1997; Butler et al., J. Chem. Phys. 109, 6519, 1998). U is the energy of dipoles and walls;
    in a periodic cell each grain interacts with the nearest image of every other grain.

    Parameters
    ----------
    scene : Scene
        Scene that the grains belong to.
    frames : float (f, n, 2)
        Positions of the grains in each frame [m]; NaN for absent grains.
    piston_height : float or float (f,), optional
        Height of the piston [m]; if not given, the height in the scene.
    forces : float (f, n, 2), optional
        Forces of a run at these frames [N]; these include weight and the inertia of a shaken cell. If not
        given, the forces of dipoles and walls are computed.

    Returns
    -------
    float
        Boltzmann's constant times the temperature [J]; NaN if no grain is present or a height is NaN.

    Raises
    ------
    InputError
        If a shape does not match, there are no frames, the scene has no dipoles or has discs instead
        (``grains.magnets = "cylinders"``), or the scene has an effect outside `KNOWN`. If ``forces``
        are given, the effects in `WITHOUT_LAPLACIAN` are also allowed.

    Examples
    --------
    For the part of a run from 0.5 s on:

    >>> late = run.dataset.isel(frame=run.dataset.frame_time.values >= 0.5)
    >>> configurational_temperature(
    ...     run.scene, late.position.values, late.frame_height.values, late.force.values
    ... )
    """
    array = checked_frames(frames, minimum_count=1)
    heights: list[float | None] = [None] * len(array)
    if piston_height is not None:
        if np.shape(piston_height) not in ((), (len(array),)):
            raise InputError(
                f"piston_height has the shape {np.shape(piston_height)}; pass one height per frame"
            )
        heights = np.broadcast_to(piston_height, len(array)).tolist()
    known: tuple[str, ...] = KNOWN
    if forces is not None:
        if np.shape(forces) != array.shape:
            raise InputError(f"forces have the shape {np.shape(forces)}; the shape must be {array.shape}")
        known = (*KNOWN, *WITHOUT_LAPLACIAN)
    _check_effects_have_known_laplacian(scene, known)
    squared_gradient = total_laplacian = 0.0
    for positions, height in zip(array, heights, strict=True):
        pairs, pair_laplacian = _pair_forces_and_laplacian(scene, positions)
        walls, wall_laplacian = _wall_forces_and_laplacian(scene, positions, height)
        squared_gradient += float(np.nansum((pairs + walls) ** 2))
        total_laplacian += pair_laplacian + wall_laplacian
    if forces is not None:
        squared_gradient = float(np.nansum(np.square(forces)))
    return squared_gradient / total_laplacian if total_laplacian else np.nan


def _check_effects_have_known_laplacian(scene: Scene, known: tuple[str, ...]) -> None:
    unknown = [effect.key for effect in scene.effects.acting if effect.key not in known]
    if scene.grains.magnets != "dipoles":
        raise InputError(
            "grains.magnets = 'cylinders': the configurational temperature is implemented for "
            "dipoles only; use 'dipoles'"
        )
    if unknown or scene.effects.dipole is None:
        raise InputError(
            f"effects.{unknown[0] if unknown else 'dipole'}: the configurational temperature is "
            "implemented for dipoles and walls only; use a scene with only dipoles and walls"
        )


def _pair_forces_and_laplacian(scene: Scene, positions: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the pair forces, and the Laplacian of the pair energy C/r^3: the sum of 9 C/r^5."""
    strength = dipole_pair_strength(magnetic_moment_of_first_species(scene))
    present, moments = np.flatnonzero(present_grain_mask(positions)), relative_magnetic_moments(scene)
    forces, laplacian = np.zeros_like(positions), 0.0
    for block in iterate_pair_forces(scene, positions):
        forces[block.grains] = block.forces.sum(axis=1)
        r = np.linalg.norm(block.branches, axis=2)
        moment_products = moments[block.grains][:, None] * moments[present][None]
        with np.errstate(divide="ignore"):
            laplacian += 9.0 * strength * float(np.where(r > 0.0, moment_products / r**5, 0.0).sum())
    return forces, laplacian


def _wall_forces_and_laplacian(
    scene: Scene, positions: np.ndarray, height: float | None
) -> tuple[np.ndarray, float]:
    """Return the forces of the walls, and the Laplacian of their energy (minus the forces' divergence)."""

    def forces_at(displacement: np.ndarray) -> np.ndarray:
        result = wall_branches_and_forces(scene, positions + displacement, height)
        total = np.zeros_like(positions)
        total[result.grains] = result.forces.sum(axis=1)
        return total

    step = _STEP * scene.grains.species[0].diameter
    divergence = 0.0
    for axis, displacement in enumerate(step * np.eye(2)):
        change = forces_at(displacement) - forces_at(-displacement)
        divergence += float(change[:, axis].sum()) / (2.0 * step)
    return forces_at(np.zeros(2)), -divergence
