"""Configurational temperature: what the places of the grains say of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.observables.frames import chosen_frames
from granular.observables.interactions import moments_of, pair_interactions, wall_interactions
from granular.observables.moduli import dipole_strength
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene

KNOWN = ("bath", "dipole", "drag", "eddy", "walls")
STRAIGHT = ("friction", "gravity", "shaking")
"""Effects that add nothing to the Laplacian of the potential."""
_STEP = 1e-5


def configurational_temperature(
    scene: Scene, frames: np.ndarray, piston_height: float | None = None
) -> float:
    """<|grad U|^2>/<laplacian U> over frames, k_B times a temperature [J].

    It equals the kinetic temperature in equilibrium (Rugh, Phys. Rev. Lett. 78, 772, 1997; Butler
    et al., J. Chem. Phys. 109, 6519, 1998), and needs no velocities. U is that of dipoles and
    walls.

    Parameters
    ----------
    scene : Scene
    frames : float (f, n, 2)
        Positions [m].
    piston_height : float, optional
        [m]; the scene's where not given.

    Raises
    ------
    InputError
        If a shape does not fit, another effect has a potential, or there are no dipoles.
    """
    array = np.asarray(frames, dtype=np.float64)
    if array.ndim != 3 or array.shape[2] != 2:
        raise InputError(f"positions of frames have the shape {array.shape}; (f, n, 2) is wanted")
    _check(scene, KNOWN)
    square = bend = 0.0
    for positions in array:
        forces, laplacian = _of_pairs(scene, positions)
        walls, more = _of_walls(scene, positions, piston_height)
        square += float(np.nansum((forces + walls) ** 2))
        bend += laplacian + more
    return square / bend


def configurational_temperature_of_run(
    run: Trajectory, start: float = 0.0, stop: float = np.inf
) -> float:
    """`configurational_temperature` over the frames with start <= time <= stop [J].

    By the forces of the run: weight counts, and so does the inertia of a shaken cell.

    Raises
    ------
    InputError
        If there are no such frames, no dipoles, or an effect other than `KNOWN` and `STRAIGHT`.
    """
    chosen = chosen_frames(run, start, stop)
    data = run.dataset
    frames = zip(data["position"].values[chosen], data["frame_height"].values[chosen], strict=True)
    bend = sum(laplacian_of(run.scene, places, float(height)) for places, height in frames)
    return float(np.nansum(data["force"].values[chosen] ** 2)) / bend


def laplacian_of(scene: Scene, positions: np.ndarray, piston_height: float | None = None) -> float:
    """Laplacian of U of dipoles and walls [N/m]; weight and shaking have none.

    Parameters and errors as of `configurational_temperature`, but for one frame (n, 2), and with
    effects that act by a uniform force or by friction besides.
    """
    _check(scene, (*KNOWN, *STRAIGHT))
    return _of_pairs(scene, positions)[1] + _of_walls(scene, positions, piston_height)[1]


def _check(scene: Scene, known: tuple[str, ...]) -> None:
    other = [one.key for one in scene.effects.all if one.key not in known]
    if other or scene.effects.dipole is None:
        raise InputError(
            f"effects.{other[0] if other else 'dipole'}: only dipoles and walls are known here; "
            "measure a scene of these"
        )


def _of_pairs(scene: Scene, positions: np.ndarray) -> tuple[np.ndarray, float]:
    """Forces, and the Laplacian of C/r^3, which is 9 C/r^5."""
    from granular.scene.scales import Scales

    scales = Scales.of(scene.grains)
    strength = dipole_strength(scales.current * scales.length**2)
    here, moments = np.flatnonzero(np.isfinite(positions).all(axis=1)), moments_of(scene)
    forces, laplacian = np.zeros_like(positions), 0.0
    for some in pair_interactions(scene, positions):
        forces[some.grains] = some.forces.sum(axis=1)
        r = np.linalg.norm(some.branches, axis=2)
        both = moments[some.grains][:, None] * moments[here][None]
        with np.errstate(divide="ignore"):
            laplacian += 9.0 * strength * float(np.where(r > 0.0, both / r**5, 0.0).sum())
    return forces, laplacian


def _of_walls(
    scene: Scene, positions: np.ndarray, height: float | None
) -> tuple[np.ndarray, float]:
    """Forces, and minus their divergence by differences."""

    def pushed(by: np.ndarray) -> np.ndarray:
        found = wall_interactions(scene, positions + by, height)
        total = np.zeros_like(positions)
        total[found.grains] = found.forces.sum(axis=1)
        return total

    step = _STEP * scene.grains.species[0].diameter
    divergence = 0.0
    for axis, way in enumerate(step * np.eye(2)):
        divergence += float((pushed(way) - pushed(-way))[:, axis].sum()) / (2.0 * step)
    return pushed(np.zeros(2)), -divergence
