"""Kinetic (granular) and configurational temperature of the bed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.observables.frame import check_frames, check_grain_values, check_vectors, is_present
from granular.observables.interactions import (
    iterate_pair_forces,
    iterate_wall_forces,
    relative_magnetic_moments,
)
from granular.observables.moduli import dipole_pair_strength, first_species_moment
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float

    from granular.scene.scene import Scene


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
