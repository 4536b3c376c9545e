"""The stress of each grain, from its virial and its Voronoi cell; its trace is a pressure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.observables.frames import frame_array
from granular.observables.interactions import pair_interactions, wall_interactions
from granular.observables.voronoi import VoronoiCells, voronoi_cells

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene


def grain_virials(
    scene: Scene, positions: np.ndarray, piston_height: float | None = None
) -> np.ndarray:
    """Virial of each grain: sum of branch times force, half for a pair and whole for a wall.

    The branch of a pair belongs to both grains, that of a wall to one alone. So the sum over all
    grains is that of the bed: with every grain at rest its yy component is the piston force times
    the piston's height, plus what weight and friction hold (the virial theorem).

    Parameters
    ----------
    scene : Scene
    positions : float (n, 2)
        [m]; NaN for absent grains.
    piston_height : float, optional
        [m]; the scene's where not given.

    Returns
    -------
    float (n, 2, 2)
        [J], positive where the grain is pressed; NaN for absent grains.

    Raises
    ------
    InputError
        As of `granular.observables.compressive_forces`.
    """
    virials = np.full((len(positions), 2, 2), np.nan)
    for some in pair_interactions(scene, positions):
        virials[some.grains] = 0.5 * np.einsum("kmi,kmj->kij", some.branches, some.forces)
    walls = wall_interactions(scene, positions, piston_height)
    virials[walls.grains] += np.einsum("kmi,kmj->kij", walls.branches, walls.forces)
    return virials


def grain_stresses(
    scene: Scene,
    positions: np.ndarray,
    piston_height: float | None = None,
    cells: VoronoiCells | None = None,
) -> np.ndarray:
    """`grain_virials` over the area of the Voronoi cell: the stress tensor of each grain.

    Returns
    -------
    float (n, 2, 2)
        [N/m], positive for compression; NaN for grains without an interior Voronoi cell.
    """
    cells = voronoi_cells(scene.cell.inside(positions)) if cells is None else cells
    return grain_virials(scene, positions, piston_height) / cells.area[:, None, None]


def grain_pressures(
    scene: Scene,
    positions: np.ndarray,
    piston_height: float | None = None,
    cells: VoronoiCells | None = None,
) -> np.ndarray:
    """Half the trace of `grain_stresses` (n,) [N/m]; NaN without an interior Voronoi cell."""
    stresses = grain_stresses(scene, positions, piston_height, cells)
    return np.asarray(0.5 * np.trace(stresses, axis1=1, axis2=2))


def grain_stress_series(run: Trajectory) -> xarray.DataArray:
    """`grain_stresses` of every frame [N/m], on (``frame``, ``grain``, ``row``, ``column``)."""
    data = run.dataset
    frames = zip(data["position"].values, data["frame_height"].values, strict=True)
    values = [grain_stresses(run.scene, positions, float(at)) for positions, at in frames]
    return frame_array(
        run,
        np.reshape(values, (*data["position"].shape[:2], 2, 2)),
        "N/m",
        "stress of the grain, positive for compression",
        ("frame", "grain", "row", "column"),
        {name: data[name] for name in ("grain", "species", "diameter")},
    )
