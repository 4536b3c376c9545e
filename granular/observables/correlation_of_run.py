"""Correlations over distance, pooled over the frames of a run."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from granular.observables.frames import chosen_frames
from granular.observables.pairs_in_bins import default_edges, spanning

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory

Found = TypeVar("Found")


def in_each_frame(
    correlation: Callable[[np.ndarray, np.ndarray], Found],
    run: Trajectory,
    edges: np.ndarray | None,
    start: float,
    stop: float,
) -> list[Found]:
    """A correlation of the frames with start <= time <= stop [s], all in the same bins.

    Raises
    ------
    InputError
        As the correlation, and where there is no such frame.
    """
    chosen = run.dataset["position"].values[chosen_frames(run, start, stop)]
    frames = spanning(run.scene.cell.inside(chosen))
    if edges is None:
        edges = min((default_edges(one) for one in frames), key=lambda found: float(found[-1]))
    return [correlation(one, edges) for one in frames]


def mean_per_pair(total: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """NaN in bins without pairs."""
    return np.where(pairs > 0, total / np.maximum(pairs, 1), np.nan)


def mean_of_frames(values: list[np.ndarray], pairs: list[np.ndarray]) -> np.ndarray:
    """The mean over all pairs of all frames, of the means over the pairs of each."""
    total = np.sum(
        [np.where(count > 0, one * count, 0.0) for one, count in zip(values, pairs, strict=True)],
        axis=0,
    )
    return mean_per_pair(total, np.sum(pairs, axis=0))


def on_distance(values: np.ndarray, edges: np.ndarray, name: str) -> xarray.DataArray:
    """Values of bins on ``distance``, the middle of the bins [m]."""
    import xarray

    return xarray.DataArray(
        values,
        dims="distance",
        coords={"distance": ("distance", 0.5 * (edges[:-1] + edges[1:]), {"units": "m"})},
        attrs={"units": "1", "long_name": name},
    )
