"""Relative fluctuation of the forces on the grains, species by species."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.observables.forces import force_magnitudes, interaction_forces
from granular.observables.frames import frame_array, frame_positions, values_of_grains
from granular.observables.voronoi import voronoi_cells

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


def relative_fluctuation(magnitudes: np.ndarray, species: np.ndarray) -> np.ndarray:
    """|F_k - mean F| / mean F, with the mean over the species of grain k [D, eq. 4.35].

    Parameters
    ----------
    magnitudes : float (n,)
        Of the forces on the grains [N]; NaN for grains that are not to count.
    species : int (n,)
        Index of each grain's species.

    Returns
    -------
    float (n,)
        NaN for grains that do not count, and where the mean is 0.

    Raises
    ------
    InputError
        If shapes do not fit.
    """
    magnitudes = np.asarray(magnitudes, dtype=np.float64)
    magnitudes = values_of_grains("magnitudes", magnitudes, magnitudes.size)
    species = values_of_grains("species", species, len(magnitudes))
    fluctuation = np.full(len(magnitudes), np.nan)
    for one in np.unique(species):
        chosen = (species == one) & np.isfinite(magnitudes)
        mean = magnitudes[chosen].mean() if chosen.any() else 0.0
        if mean > 0.0:
            fluctuation[chosen] = np.abs(magnitudes[chosen] - mean) / mean
    return fluctuation


def fluctuation_series(run: Trajectory) -> xarray.DataArray:
    """`relative_fluctuation` of the magnetic forces of every frame, on (``frame``, ``grain``).

    As in [D, Fig. 4.24] only grains with an interior Voronoi cell count; the others are NaN here,
    and drawn as 0 there.
    """
    data = run.dataset
    magnitudes = force_magnitudes(interaction_forces(run).values)
    owner = data["species"].values
    rows = []
    for positions, sizes in zip(frame_positions(run), magnitudes, strict=True):
        inside = voronoi_cells(positions).interior
        rows.append(relative_fluctuation(np.where(inside, sizes, np.nan), owner))
    return frame_array(
        run,
        np.reshape(rows, magnitudes.shape),
        "1",
        "relative fluctuation of the force on the grain",
        ("frame", "grain"),
        {name: data[name] for name in ("grain", "species", "diameter")},
    )
