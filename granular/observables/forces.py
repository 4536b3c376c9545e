"""Forces on the piston, the walls and the grains."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.observables.frames import frame_array
from granular.observables.interactions import pair_interactions, wall_interactions
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene


_WALLS = ("left", "right", "bottom", "piston")


def force_magnitudes(forces: np.ndarray) -> np.ndarray:
    """Magnitudes (..., n) [N] of forces (..., n, 2) [N]; NaN for absent grains.

    Examples
    --------
    >>> import numpy as np
    >>> from granular.observables import force_magnitudes
    >>> print(force_magnitudes(np.array([[3.0, 4.0], [0.0, 2.0]])))
    [5. 2.]
    """
    return np.asarray(np.linalg.norm(np.asarray(forces, dtype=np.float64), axis=-1))


def piston_force(run: Trajectory) -> xarray.DataArray:
    """Force of the grains on the piston, upwards [N], on ``time``.

    Raises
    ------
    InputError
        If nothing acts on the piston.
    """
    if "piston_force" not in run.dataset:
        raise InputError(
            f"scene {run.scene.name!r} records no piston force; give it a piston and "
            "effects.walls.top"
        )
    return run.dataset["piston_force"]


def wall_forces(run: Trajectory) -> xarray.DataArray:
    """Force of the grains on every wall that acts, outwards [N], on (``time``, ``wall``).

    Raises
    ------
    InputError
        If the scene has no walls.
    """
    import xarray

    present = [wall for wall in _WALLS if f"{wall}_force" in run.dataset]
    if not present:
        raise InputError(f"scene {run.scene.name!r} has no walls; give it effects.walls")
    return xarray.DataArray(
        np.stack([run.dataset[f"{wall}_force"].values for wall in present], axis=1),
        dims=("time", "wall"),
        coords={"time": run.dataset["time"], "wall": present},
        attrs={"units": "N", "long_name": "force on the wall, outwards"},
    )


def grain_forces(run: Trajectory) -> xarray.DataArray:
    """Force on each grain as the run has it (magnetic, weight, contact, and inertia where the cell
    is shaken) [N], on (``frame``, ``grain``, ``axis``).
    """
    return run.dataset["force"]


def interaction_forces(run: Trajectory) -> xarray.DataArray:
    """Force of grains and walls on each grain [N], on (``frame``, ``grain``, ``axis``).

    This is `grain_forces` without weight and inertia: the resulting magnetic force of
    [D, 4.3.5], and contact where the scene has it.
    """
    masses = grain_masses(run)
    body = masses[None, :, None] * _body_acceleration(run)[:, None, :]
    data = run.dataset
    return frame_array(
        run,
        data["force"].values - body,
        "N",
        "force of grains and walls on the grain",
        ("frame", "grain", "axis"),
        {name: data[name] for name in ("grain", "axis", "species", "diameter")},
    )


def grain_masses(run: Trajectory) -> np.ndarray:
    """Mass of each grain (n,) [kg]."""
    return run.scene.grains.masses()


def _body_acceleration(run: Trajectory) -> np.ndarray:
    """Acceleration by weight and by the shaken cell, of every frame (f, 2) [m/s^2]."""
    times = run.dataset["frame_time"].values
    acceleration = np.zeros((len(times), 2))
    gravity, shaking = run.scene.effects.gravity, run.scene.effects.shaking
    if gravity is not None:
        acceleration[:, 1] -= gravity.acceleration
    if shaking is not None:
        omega = 2.0 * np.pi * shaking.frequency
        swing = shaking.amplitude * omega**2 * np.sin(omega * times)
        acceleration += swing[:, None] * [np.cos(shaking.angle), np.sin(shaking.angle)]
    return acceleration


def compressive_forces(
    scene: Scene, positions: np.ndarray, piston_height: float | None = None
) -> np.ndarray:
    """Sum of the magnitudes of all forces of other grains and of walls on each grain.

    De Paula writes it apart from the resulting force (``comPart`` and ``forPart``) and draws its
    distribution [D, 4.3.5, Fig. 5.3, Appendix B]. In a bed at rest the resulting force is what
    friction holds, some hundredths of it.

    Parameters
    ----------
    scene : Scene
    positions : float (n, 2)
        [m]; NaN for absent grains.
    piston_height : float, optional
        [m]; the scene's where not given.

    Returns
    -------
    float (n,)
        [N]; NaN for absent grains.

    Raises
    ------
    InputError
        If the shape is not that of the scene's grains, or an effect acts between grains by a law
        other than dipole and contact.
    """
    total = np.full(len(positions), np.nan)
    for some in pair_interactions(scene, positions):
        total[some.grains] = np.linalg.norm(some.forces, axis=2).sum(axis=1)
    walls = wall_interactions(scene, positions, piston_height)
    total[walls.grains] += np.linalg.norm(walls.forces, axis=2).sum(axis=1)
    return total


def compressive_force_series(run: Trajectory) -> xarray.DataArray:
    """`compressive_forces` of every frame [N], on (``frame``, ``grain``)."""
    data = run.dataset
    frames = zip(data["position"].values, data["frame_height"].values, strict=True)
    values = [compressive_forces(run.scene, positions, float(at)) for positions, at in frames]
    return frame_array(
        run,
        np.reshape(values, data["position"].shape[:2]),
        "N",
        "compressive force on the grain",
        ("frame", "grain"),
        {name: data[name] for name in ("grain", "species", "diameter")},
    )
