"""The compressive force of a grain: how hard all others and the walls press on it together."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.observables.frames import frame_array
from granular.observables.interactions import pair_interactions, wall_interactions

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene


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
