"""Motion of grains: their temperature, functions of the lag between frames, Lindemann's parameter, D2min."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.observables.forces import iterate_pair_forces, iterate_wall_forces, relative_magnetic_moments
from granular.observables.frame import (
    Observable,
    check_frames,
    check_grain_values,
    check_lags,
    check_periods,
    check_vectors,
    is_present,
    labelled_array,
    observable,
    observable_metadata,
    select_frames,
    sum_by_index,
)
from granular.observables.moduli import dipole_pair_strength, first_species_moment
from granular.observables.voronoi import voronoi_cells
from granular.shared.array_types import Float
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene


EVEN = 1e-6
"""Greatest difference of the times between frames, over their mean."""


def per_lag(
    run: Trajectory, function: Callable[..., np.ndarray], start: float = 0.0, stop: float = np.inf
) -> xarray.DataArray:
    """Evaluate a function of the lag over the frames with start <= time <= stop.

    Parameters
    ----------
    run : Trajectory
        Finished run, or one that was cut off.
    function : function of frames (f, n, 2) [m] and lags (k,)
        `mean_square_displacement`, `non_gaussian_parameter`, `lindemann_parameter` or
        `bond_relaxation`, or one's own. Positions are not brought back into a periodic cell; a
        function with the argument ``periods`` is given its sides.
    start, stop : float
        First and last time of the frames [s].

    Returns
    -------
    xarray.DataArray
        Values (k,) on ``lag`` [s], at about 30 lags of even ratios, NaN where the function returns it; with
        unit and meaning if the function is an `observable`.

    Raises
    ------
    InputError
        As the function, and if no frame lies in the range, there is only one, or they are not evenly
        spaced in time.
    """
    chosen = select_frames(run, start, stop)
    frames = check_frames(run.dataset["position"].values[chosen], least=2)
    steps = np.diff(run.dataset["frame_time"].values[chosen])
    if np.ptp(steps) > EVEN * len(steps) * steps.mean():
        raise InputError(
            f"frames lie {steps.min():.3g} to {steps.max():.3g} s apart; choose start and stop "
            "within one stage of even frames"
        )
    lags, options = check_lags(None, len(frames)), {}
    if "periods" in inspect.signature(function).parameters:
        options["periods"] = run.scene.cell.periods
    coordinates = {"lag": ("lag", lags * steps.mean(), {"units": "s"})}
    values = np.asarray(function(frames, lags, **options))
    return labelled_array(values, "lag", coordinates, observable_metadata(function))


@observable("m^2", "mean square displacement")
def mean_square_displacement(frames: np.ndarray, lags: np.ndarray | None = None) -> np.ndarray:
    """Mean square displacement <|r(t) - r(0)|^2> over grains and frames.

    Every pair of frames that lie a lag apart counts (Allen and Tildesley, Computer Simulation of
    Liquids, 2nd ed. 2017).

    Parameters
    ----------
    frames : float (f, n, 2)
        Positions of the grains in each frame [m], not brought back into a periodic cell; NaN for absent
        grains.
    lags : int (k,), optional
        Numbers of frames, 1 to f - 1; about 30 at even ratios if not given.

    Returns
    -------
    float64 (k,)
        Mean square at each lag [m^2].

    Raises
    ------
    InputError
        If a shape or lag does not fit, there are fewer than two frames, or no grain is present in both of
        two frames that lie a lag apart.
    """
    frames = check_frames(frames, least=2)
    means = []
    for lag in check_lags(lags, len(frames)):
        squares = ((frames[lag:] - frames[:-lag]) ** 2).sum(axis=2)
        squares = squares[np.isfinite(squares)]
        if not len(squares):
            raise InputError(f"no grain is present in two frames {lag} apart; take shorter lags")
        means.append(squares.mean())
    return np.array(means)


@observable("1", "dynamic Lindemann parameter")
def lindemann_parameter(
    frames: np.ndarray, lags: np.ndarray | None = None, periods: tuple[float, float] | None = None
) -> np.ndarray:
    """Lindemann parameter gamma(t) = <|du_i(t) - du_j(t)|^2>/(2 a^2) over neighbours i and j.

    du is the displacement of a grain in the time t, neighbours are those of the Voronoi cells of
    the earlier frame with an interior cell both, and a is the spacing of the hexagonal lattice of
    the mean cell area. It stays finite in a crystal in two dimensions, where the mean square
    displacement does not (Zahn, Lenke and Maret, Phys. Rev. Lett. 82, 2721, 1999); in layers of
    dipoles it stays below 0.033 up to melting (Zahn and Maret, Phys. Rev. Lett. 85, 3656, 2000).

    Parameters
    ----------
    frames : float (f, n, 2)
        Positions of the grains in each frame [m]; NaN for absent grains.
    lags : int (k,), optional
        Numbers of frames, 1 to f - 1; about 30 at even ratios if not given.
    periods : (float, float), optional
        Sides of a periodic cell [m], above 0, within which neighbours are looked for; positions are then
        those that were not brought back.

    Returns
    -------
    float64 (k,)
        Parameter at each lag, without unit.

    Raises
    ------
    InputError
        If a shape, lag or period does not fit, there are fewer than two frames, or at some lag no two
        neighbours with interior cells are present in both frames.
    """
    frames = check_frames(frames, least=2)
    sides = None if periods is None else check_periods(periods)
    lags = check_lags(lags, len(frames))
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
        raise InputError("no neighbours have interior cells in both frames; give a larger bed")
    # 2 a^2, a^2 = (2/sqrt(3)) times the area of a hexagonal cell.
    return np.asarray(total / number / (2.0 * 2.0 / np.sqrt(3.0) * area.mean()))


class NonAffineMotion(NamedTuple):
    """Motion of the neighbours of each grain between two frames; NaN where it is not known."""

    d2min: Float[np.ndarray, "n"]  # mean square that the best local strain leaves [m^2]
    strain: Float[np.ndarray, "n 2 2"]  # best local deformation gradient minus 1


def non_affine_motion(first: np.ndarray, second: np.ndarray) -> NonAffineMotion:
    """D2min of each grain with an interior cell between two frames.

    The least mean over its Voronoi neighbours j in the first frame of

        |r_j'' - r_i'' - F (r_j' - r_i')|^2

    over all matrices F (Falk and Langer, Phys. Rev. E 57, 7192, 1998, who take the sum over the
    grains within a distance).

    Parameters
    ----------
    first, second : float (n, 2)
        Positions in both frames [m], not brought back into a periodic cell in between; NaN for absent
        grains.

    Returns
    -------
    NonAffineMotion
        D2min [m^2] (n,) and local strain (n, 2, 2), without unit; NaN for grains without an interior cell
        in the first frame, absent in the second, or with fewer than three neighbours there.

    Raises
    ------
    InputError
        If the positions have another shape than (n, 2), or the frames differ in their number of grains.
    """
    first, second = check_vectors(first), check_vectors(second)
    if first.shape != second.shape:
        raise InputError(f"{len(first)} and {len(second)} grains; give two frames of the same bed")
    cells = voronoi_cells(first)
    both = np.concatenate([cells.neighbours, cells.neighbours[:, ::-1]])
    before = first[both[:, 1]] - first[both[:, 0]]
    after = second[both[:, 1]] - second[both[:, 0]]
    known = np.isfinite(after).all(axis=1)
    i, before, after = both[known, 0], before[known], after[known]
    count = len(first)
    mixed = sum_by_index(i, after[:, :, None] * before[:, None, :], count)
    square = sum_by_index(i, before[:, :, None] * before[:, None, :], count)
    number = np.bincount(i, minlength=count)
    # Two bonds have four components, as the gradient: it would fit them exactly, with D2min 0.
    able = cells.interior & (number > 2) & is_present(second)
    gradient = np.full((count, 2, 2), np.nan)
    gradient[able] = np.linalg.solve(square[able], mixed[able].transpose(0, 2, 1)).transpose(0, 2, 1)
    rest = after - np.einsum("jab,jb->ja", gradient[i], before)
    total = np.bincount(i, (rest**2).sum(axis=1), minlength=count)
    d2min = np.where(able, total / np.maximum(number, 1), np.nan)
    return NonAffineMotion(d2min, gradient - np.eye(2))


def non_affine_series(run: Trajectory, every: int = 1) -> xarray.DataArray:
    """D2min of each grain since ``every`` frames before, as `non_affine_motion` defines it.

    (Falk and Langer, Phys. Rev. E 57, 7192, 1998.)

    Parameters
    ----------
    run : Trajectory
        Finished run, or one that was cut off.
    every : int
        Frames from the first to the second of the two that are compared, 1 or more.

    Returns
    -------
    xarray.DataArray
        D2min [m^2] on (``frame``, ``grain``); NaN in the first ``every`` frames, and where
        `non_affine_motion` is.

    Raises
    ------
    InputError
        If ``every`` is below 1.
    """
    if every < 1:
        raise InputError(f"every {every}; take 1 frame or more")
    frames = run.dataset["position"].values
    result = np.full(frames.shape[:2], np.nan)
    for k in range(every, len(frames)):
        # To where the neighbours are, in a periodic cell; the displacements between frames stay.
        home = run.scene.cell.wrap_positions(frames[k - every]) - frames[k - every]
        result[k] = non_affine_motion(frames[k - every] + home, frames[k] + home).d2min
    label = Observable("d2min", "m^2", "non-affine motion D2min")
    return labelled_array(result, ("frame", "grain"), {"frame_time": run.dataset["frame_time"]}, label)


def kinetic_temperature(velocities: np.ndarray, masses: np.ndarray) -> float:
    """Mean kinetic energy of the fluctuations per degree of freedom, (1/2) <m |v - V|^2>.

    V is the velocity of the centre of mass of the grains given. (Goldhirsch, Annu. Rev. Fluid Mech.
    35, 267, 2003, leaves the mass out; with it, species in equilibrium have one temperature.)

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
        If shapes do not fit, or the mass of a grain that is there is not above 0.

    Examples
    --------
    >>> import numpy as np
    >>> from granular.observables import kinetic_temperature
    >>> kinetic_temperature(np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([2.0, 2.0]))
    1.0
    """
    velocities = check_vectors(velocities, "velocities")
    masses = check_grain_values("masses", masses, len(velocities))
    if not (masses[is_present(velocities)] > 0.0).all():
        raise InputError("a mass is not above 0 kg; give the masses of the grains")
    energies = fluctuation_energies(velocities, masses)
    energies = energies[np.isfinite(energies)]
    return float(energies.mean()) if len(energies) else np.nan


def fluctuation_energies(
    velocities: Float[np.ndarray, "n 2"], masses: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n"]:
    """Energy (1/2) m |v - V|^2, V of the mass centre (Goldhirsch 2003) [J]; velocities [m/s], masses [kg]."""
    here = is_present(velocities)
    if not here.any():
        return np.full(len(masses), np.nan)
    drift = np.average(velocities[here], axis=0, weights=masses[here])
    return np.asarray(0.5 * masses * ((velocities - drift) ** 2).sum(axis=1))


KNOWN = ("bath", "dipole", "drag", "eddy", "walls")
STRAIGHT = ("friction", "gravity", "shaking")
"""Effects that add nothing to the Laplacian of the potential."""
# In diameters: central differences err by 1e-10 by truncation and 1e-11 by rounding.
_STEP = 1e-5


def configurational_temperature(
    scene: Scene,
    frames: np.ndarray,
    piston_height: float | np.ndarray | None = None,
    forces: np.ndarray | None = None,
) -> float:
    """Temperature <|grad U|^2>/<laplacian U> of the positions in frames, times Boltzmann's constant.

    It equals the kinetic temperature in equilibrium (Rugh, Phys. Rev. Lett. 78, 772, 1997; Butler
    et al., J. Chem. Phys. 109, 6519, 1998), and needs no velocities. U is the energy of dipoles and
    walls; each grain meets the nearest image of every other one in a periodic cell.

    Parameters
    ----------
    scene : Scene
        Scene that the grains belong to.
    frames : float (f, n, 2)
        Positions of the grains in each frame [m]; NaN for absent grains.
    piston_height : float or float (f,), optional
        Height of the piston [m]; the scene's where not given.
    forces : float (f, n, 2), optional
        Forces of a run at these frames [N]: weight counts then, and so does the inertia of a shaken
        cell. Those of dipoles and walls if not given.

    Returns
    -------
    float
        Boltzmann's constant times the temperature [J]; NaN where no grain is present, or a height is NaN.

    Raises
    ------
    InputError
        If a shape does not fit, there is no frame, there are no dipoles or discs in their place
        (``grains.magnets = "cylinders"``), or there is an effect other than `KNOWN`, and with ``forces``
        other than `KNOWN` and `STRAIGHT`.

    Examples
    --------
    Of a run, from 0.5 s on:

    >>> late = run.dataset.isel(frame=run.dataset.frame_time.values >= 0.5)
    >>> configurational_temperature(
    ...     run.scene, late.position.values, late.frame_height.values, late.force.values
    ... )
    """
    array = check_frames(frames, least=1)
    heights: list[float | None] = [None] * len(array)
    if piston_height is not None:
        if np.shape(piston_height) not in ((), (len(array),)):
            raise InputError(f"piston_height has the shape {np.shape(piston_height)}; give one a frame")
        heights = np.broadcast_to(piston_height, len(array)).tolist()
    known: tuple[str, ...] = KNOWN
    if forces is not None:
        if np.shape(forces) != array.shape:
            raise InputError(f"forces have the shape {np.shape(forces)}; {array.shape} is wanted")
        known = (*KNOWN, *STRAIGHT)
    _check_effects_known(scene, known)
    square = bend = 0.0
    for positions, height in zip(array, heights, strict=True):
        pairs, laplacian = _pair_forces_and_laplacian(scene, positions)
        walls, more = _wall_forces_and_laplacian(scene, positions, height)
        square += float(np.nansum((pairs + walls) ** 2))
        bend += laplacian + more
    if forces is not None:
        square = float(np.nansum(np.square(forces)))
    return square / bend if bend else np.nan


def _check_effects_known(scene: Scene, known: tuple[str, ...]) -> None:
    other = [effect.key for effect in scene.effects.acting if effect.key not in known]
    if scene.grains.magnets != "dipoles":
        raise InputError("grains.magnets = 'cylinders': only dipoles are known here; take 'dipoles'")
    if other or scene.effects.dipole is None:
        raise InputError(
            f"effects.{other[0] if other else 'dipole'}: only dipoles and walls are known here; "
            "measure a scene of these"
        )


def _pair_forces_and_laplacian(scene: Scene, positions: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the forces, and the Laplacian of C/r^3, which is 9 C/r^5."""
    strength = dipole_pair_strength(first_species_moment(scene))
    here, moments = np.flatnonzero(is_present(positions)), relative_magnetic_moments(scene)
    forces, laplacian = np.zeros_like(positions), 0.0
    for some in iterate_pair_forces(scene, positions):
        forces[some.grains] = some.forces.sum(axis=1)
        r = np.linalg.norm(some.branches, axis=2)
        both = moments[some.grains][:, None] * moments[here][None]
        with np.errstate(divide="ignore"):
            laplacian += 9.0 * strength * float(np.where(r > 0.0, both / r**5, 0.0).sum())
    return forces, laplacian


def _wall_forces_and_laplacian(
    scene: Scene, positions: np.ndarray, height: float | None
) -> tuple[np.ndarray, float]:
    """Return the forces, and minus their divergence by differences."""

    def forces_at(by: np.ndarray) -> np.ndarray:
        result = iterate_wall_forces(scene, positions + by, height)
        total = np.zeros_like(positions)
        total[result.grains] = result.forces.sum(axis=1)
        return total

    step = _STEP * scene.grains.species[0].diameter
    divergence = 0.0
    for axis, displacement in enumerate(step * np.eye(2)):
        change = forces_at(displacement) - forces_at(-displacement)
        divergence += float(change[:, axis].sum()) / (2.0 * step)
    return forces_at(np.zeros(2)), -divergence
