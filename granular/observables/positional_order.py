"""Translational order: structure factor, reciprocal lattice vector and correlation g_T(r)."""

from __future__ import annotations

import math

import numpy as np

from granular.observables.correlation import (
    PairDistanceFunction,
    check_bin_edges,
    default_bin_edges,
    mean_over_pairs,
    sum_pair_products,
)
from granular.observables.frame import check_vectors, observable, present_positions
from granular.observables.voronoi import voronoi_cells
from granular.shared.errors import InputError

# The next ring of peaks is a factor sqrt(3) away; strain and defects shift this one far less.
RING = 0.15
"""Half width of the search for a peak about the length in the hexagonal lattice of the mean cell area."""

# In a wavelength: counting by meshes leaves sinc(pi/5) = 0.94 of a peak's amplitude.
_MESHES = 5
# Halvings: the peak is known to 1/4096 of its width at last.
_NARROWINGS = 12


def structure_factor(positions: np.ndarray, wave_vectors: np.ndarray) -> np.ndarray:
    """Structure factor S(q) = |sum exp(i q r)|^2/n of the grains that are present.

    (Hansen and McDonald, Theory of Simple Liquids, 4th ed. 2013, chapter 4.)

    Parameters
    ----------
    positions : float (n, 2)
        Positions r [m]; NaN for absent grains.
    wave_vectors : float (k, 2)
        Wave vectors q [1/m].

    Returns
    -------
    float64 (k,)
        Structure factor, without unit, from 0 to n; about 1 without order.

    Raises
    ------
    InputError
        If positions or wave vectors have another shape, or there is no grain.
    """
    points = present_positions(positions)
    vectors = check_vectors(wave_vectors, "wave vectors")
    if not len(points):
        raise InputError("no grain is present; give a frame with grains")
    return np.array([abs(np.exp(1j * (points @ vector)).sum()) ** 2 for vector in vectors]) / len(points)


def reciprocal_lattice_vector(positions: np.ndarray) -> np.ndarray:
    """Shortest reciprocal lattice vector of the positional order that a bed has.

    It lies where `structure_factor` is greatest within `RING` of the length 4 pi/(sqrt(3) a) that the
    hexagonal lattice of the mean cell area has, in a half plane (Nelson and Halperin, Phys. Rev. B 19,
    2457, 1979). Only grains with an interior cell count.

    Parameters
    ----------
    positions : float (n, 2)
        Positions of the grains [m]; NaN for absent grains.

    Returns
    -------
    float64 (2,)
        Reciprocal lattice vector [1/m].

    Raises
    ------
    InputError
        If the positions have another shape than (n, 2), or fewer than two grains have an interior cell.
    """
    cells = voronoi_cells(positions)
    if (inside := np.count_nonzero(cells.interior)) < 2:
        raise InputError(f"{inside} grains have an interior cell; give a larger bed, with at least 2")
    area = float(cells.area[cells.interior].mean())
    length = 2.0 * math.pi * math.sqrt(2.0 / (math.sqrt(3.0) * area))
    points = np.asarray(positions, dtype=np.float64)[cells.interior]
    best = _coarse_structure_factor_peak(points, length)
    resolution = math.pi / float(np.linalg.norm(np.ptp(points, axis=0)))
    for _ in range(_NARROWINGS):
        steps = np.linspace(-resolution, resolution, 5)
        about = best + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        best = about[np.argmax(structure_factor(points, about))]
        resolution *= 0.5
    return np.asarray(best)


def _coarse_structure_factor_peak(points: np.ndarray, length: float) -> np.ndarray:
    """About where S(q) is greatest, from grains that are counted in the meshes of a grid."""
    mesh = 2.0 * math.pi / length / _MESHES
    indices = np.floor((points - points.min(axis=0)) / mesh).astype(int)
    # Room of the same size next to the bed: a peak is then at least two points wide.
    shape = 2 * (indices.max(axis=0) + 1)
    counts = np.zeros(shape)
    np.add.at(counts, tuple(indices.T), 1.0)
    power = np.abs(np.fft.rfft2(counts)) ** 2
    qx = 2.0 * math.pi * np.fft.fftfreq(shape[0], mesh)[:, None]
    qy = 2.0 * math.pi * np.fft.rfftfreq(shape[1], mesh)[None, :]
    size = np.hypot(qx, qy)
    power[(size < (1.0 - RING) * length) | (size > (1.0 + RING) * length)] = 0.0
    row, column = np.unravel_index(np.argmax(power), power.shape)
    return np.array([qx[row, 0], qy[0, column]])


def translational_order(positions: np.ndarray, vector: np.ndarray | None = None) -> float:
    """Order parameter of translation, |mean of exp(i G r)| over the grains.

    It is 1 for a crystal at rest and about n^(-1/2) for a liquid (Nelson and Halperin, Phys. Rev. B 19,
    2457, 1979).

    Parameters
    ----------
    positions : float (n, 2)
        Positions r [m]; NaN for absent grains.
    vector : float (2,), optional
        G, a reciprocal lattice vector [1/m]; `reciprocal_lattice_vector` of the positions if not given.

    Returns
    -------
    float
        Order parameter from 0 to 1, without unit.

    Raises
    ------
    InputError
        If positions or vector have another shape, there is no grain, or, without ``vector``, fewer than two
        grains have an interior cell.
    """
    points = present_positions(positions)
    wave = _wave_vector(points, vector)
    return float(abs(np.exp(1j * (points @ wave)).mean()))


def _wave_vector(points: np.ndarray, vector: np.ndarray | None) -> np.ndarray:
    wave = reciprocal_lattice_vector(points) if vector is None else np.asarray(vector, dtype=np.float64)
    if wave.shape != (2,):
        raise InputError(f"the wave vector has the shape {wave.shape}; (2,) is wanted")
    if not len(points):
        raise InputError("no grain is present; give a frame with grains")
    return wave


@observable("1", "correlation of translational order g_T(r)")
def translational_correlation(
    positions: np.ndarray, edges: np.ndarray | None = None, vector: np.ndarray | None = None
) -> PairDistanceFunction:
    """Correlation g_T(r) = Re <exp(i G (r_i - r_j))>, the mean over pairs at the distance r.

    It tends to a constant or falls algebraically in a crystal in two dimensions, and falls
    exponentially where dislocations are free (Nelson and Halperin, Phys. Rev. B 19, 2457, 1979).

    Parameters
    ----------
    positions : float (n, 2)
        Positions of the grains [m]; NaN for absent grains.
    edges : float (k + 1,), optional
        Edges of the bins [m]; as for `radial_distribution` if not given.
    vector : float (2,), optional
        Reciprocal lattice vector G [1/m]; that of `reciprocal_lattice_vector` if not given.

    Returns
    -------
    PairDistanceFunction
        Correlation of each bin (k,), without unit, NaN in bins without pairs, and the number of its pairs.

    Raises
    ------
    InputError
        If positions or vector have another shape, there is no grain, the edges do not increase from 0 m or
        more, the grains span no box (without ``edges``), or fewer than two have an interior cell (without
        ``vector``).
    """
    points = present_positions(positions)
    edges = default_bin_edges(points) if edges is None else check_bin_edges(edges)
    wave = _wave_vector(points, vector)
    phase = points @ wave
    products = sum_pair_products(points, np.cos(phase), edges) + sum_pair_products(
        points, np.sin(phase), edges
    )
    return mean_over_pairs(points, products, edges)
