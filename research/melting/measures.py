"""Measurements of a layer in successive blocks of time, from which bootstrap intervals are computed."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.observables.motion import configurational_temperature
from research.melting.displacements import (
    LONGEST_WAVE,
    assign_grains_to_sites,
    dynamic_lindemann_parameter,
    lindemann_plateau,
    longitudinal_and_transverse_mode_squares,
    wave_vectors_of_cell,
)
from research.melting.neighbours import (
    bond_correlation_sums_and_counts,
    local_psi6,
    periodic_voronoi_neighbours,
)
from research.melting.scenes import Layer

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory

BLOCKS = 10
"""Number of blocks of the measured time, each longer than the correlation time of most of a layer's order."""

EVERY = 2
"""Frames between successive neighbour analyses."""

ORIGINS = 256
"""Number of grains at the origin of g6, chosen separately in each frame."""

BIN = 0.5
"""Width of the bins of g6, in spacings."""

LAGS = 16
"""Number of lags of the Lindemann parameter, at equal ratios up to half the measured time."""

COLD_FRAMES = 4
"""Number of frames for the configurational temperature."""


def measure_layer(layer: Layer, run: Trajectory, settling: float) -> dict[str, Any]:
    """Return order, moduli and temperatures of a layer, as plain data.

    Returns
    -------
    dict
        ``kinetic`` and ``configurational``: temperatures over the temperature of the bath. ``order``: the
        mean square of the mean psi6 of each block of time; ``defects``: fraction of the grains without six
        neighbours. ``r``, in spacings, with ``g6`` of each block. ``lags``, in units of time, with the
        ``lindemann`` parameter. ``waves``: wave vectors, times the spacing, with the mean squares of the
        modes ``along`` and ``across`` of each block, over the spacing squared. ``translation``: translational
        order of each block. ``plateau``: limit of the Lindemann parameter without exchange of grains.
    """
    data = run.dataset
    chosen = data["frame_time"].values >= settling
    frames, speeds = data["position"].values[chosen], data["velocity"].values[chosen]
    masses = run.scene.grains.masses()
    periods = layer.scene.cell.periods
    assert periods is not None
    kinetic = float((masses[None, :, None] * speeds**2).mean()) / layer.temperature
    cold = frames[np.linspace(0, len(frames) - 1, COLD_FRAMES).astype(int)]
    sites = layer.scene.initial_positions_and_velocities()[0]
    a = layer.spacing
    lags = np.unique(np.geomspace(1, len(frames) // 2, LAGS).round().astype(int))
    apart = float(np.diff(data["frame_time"].values).mean())
    vectors = wave_vectors_of_cell(periods, LONGEST_WAVE / a)
    result = [assign_grains_to_sites(item, sites, periods, a) for item in frames]
    along, across = longitudinal_and_transverse_mode_squares(result, sites, vectors)
    return {
        "gamma": layer.gamma,
        "grains": len(sites),
        "steps": int(run.settings()["steps"]),
        "kinetic": kinetic,
        "configurational": configurational_temperature(layer.scene, cold) / layer.temperature,
        **_order_figures(frames, periods, a),
        "lags": (lags * apart / layer.time).tolist(),
        "lindemann": dynamic_lindemann_parameter(frames, periods, a, lags).tolist(),
        "waves": (vectors * a).tolist(),
        "along": _block_means(along / a**2),
        "across": _block_means(across / a**2),
        "translation": [
            float(np.mean([item.order for item in block])) for block in _split_into_blocks(result)
        ],
        "plateau": lindemann_plateau(result[::EVERY], sites, periods, a),
    }


def _split_into_blocks(result: list[Any]) -> list[list[Any]]:
    edges = np.linspace(0, len(result), BLOCKS + 1).astype(int)
    return [result[first:stop] for first, stop in itertools.pairwise(edges)]


def _block_means(values: np.ndarray) -> list[list[float]]:
    return [item.mean(axis=0).tolist() for item in np.array_split(values, BLOCKS)]


def _order_figures(frames: np.ndarray, periods: tuple[float, float], spacing: float) -> dict[str, Any]:
    edges = np.arange(BIN, 0.5 * min(periods) / spacing, BIN) * spacing
    random = np.random.default_rng(1)
    rows: dict[str, list[Any]] = {"order": [], "defects": [], "g6": []}
    for block in np.array_split(frames[::EVERY], BLOCKS):
        squares, odd, totals = [], [], np.zeros((2, len(edges) - 1))
        for positions in block:
            result = periodic_voronoi_neighbours(positions, periods)
            order = local_psi6(result)
            squares.append(abs(order.mean()) ** 2)
            odd.append(float((result.sides != 6).mean()))
            some = random.choice(len(positions), min(ORIGINS, len(positions)), replace=False)
            totals += bond_correlation_sums_and_counts(positions, order, periods, edges, some)
        rows["order"].append(float(np.mean(squares)))
        rows["defects"].append(float(np.mean(odd)))
        rows["g6"].append((totals[0] / np.maximum(totals[1], 1.0)).tolist())
    return {"r": ((edges[1:] + edges[:-1]) / (2.0 * spacing)).tolist(), **rows}
