"""The structure factor S(q), and the reciprocal lattice vector of a crystal that is there."""

from __future__ import annotations

import math

import numpy as np

from granular.observables.frames import present_positions
from granular.observables.voronoi import voronoi_cells
from granular.shared.errors import InputError

RING = 0.15
"""How far from the length in the hexagonal lattice of the mean cell area a peak is looked for."""

_MESHES = 5
_NARROWINGS = 12


def structure_factor(positions: np.ndarray, wave_vectors: np.ndarray) -> np.ndarray:
    """S(q) = |sum exp(i q r)|^2/n of the grains that are present.

    Parameters
    ----------
    positions : float (n, 2)
        [m]; NaN for absent grains.
    wave_vectors : float (k, 2)
        [1/m]

    Returns
    -------
    float (k,)

    Raises
    ------
    InputError
        If a shape is another one, or there is no grain.
    """
    points = present_positions(positions)
    vectors = np.asarray(wave_vectors, dtype=np.float64)
    if vectors.ndim != 2 or vectors.shape[1] != 2:
        raise InputError(f"wave vectors have the shape {vectors.shape}; (k, 2) is wanted")
    if not len(points):
        raise InputError("no grain is present; give a frame with grains")
    return np.array([abs(np.exp(1j * (points @ one)).sum()) ** 2 for one in vectors]) / len(points)


def lattice_vector(positions: np.ndarray) -> np.ndarray:
    """The shortest reciprocal lattice vector of the order that is there (2,) [1/m].

    Where S(q) is greatest within `RING` of the length that the hexagonal lattice of the mean cell
    area has, in a half plane.

    Raises
    ------
    InputError
        If no grain has an interior cell.
    """
    cells = voronoi_cells(positions)
    if not cells.interior.any():
        raise InputError("no grain has an interior cell; give a larger bed")
    area = float(cells.area[cells.interior].mean())
    length = 2.0 * math.pi * math.sqrt(2.0 / (math.sqrt(3.0) * area))
    points = np.asarray(positions, dtype=np.float64)[cells.interior]
    best = _peak_on_a_mesh(points, length)
    span = math.pi / float(np.linalg.norm(np.ptp(points, axis=0)))
    for _ in range(_NARROWINGS):
        steps = np.linspace(-span, span, 5)
        about = best + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        best = about[np.argmax(structure_factor(points, about))]
        span *= 0.5
    return np.asarray(best)


def _peak_on_a_mesh(points: np.ndarray, length: float) -> np.ndarray:
    """About where S(q) is greatest, from grains that are counted in the meshes of a grid."""
    mesh = 2.0 * math.pi / length / _MESHES
    places = np.floor((points - points.min(axis=0)) / mesh).astype(int)
    # Room of the same size beside the bed: a peak is then at least two points wide.
    shape = 2 * (places.max(axis=0) + 1)
    counts = np.zeros(shape)
    np.add.at(counts, tuple(places.T), 1.0)
    power = np.abs(np.fft.rfft2(counts)) ** 2
    qx = 2.0 * math.pi * np.fft.fftfreq(shape[0], mesh)[:, None]
    qy = 2.0 * math.pi * np.fft.rfftfreq(shape[1], mesh)[None, :]
    size = np.hypot(qx, qy)
    power[(size < (1.0 - RING) * length) | (size > (1.0 + RING) * length)] = 0.0
    row, column = np.unravel_index(np.argmax(power), power.shape)
    return np.array([qx[row, 0], qy[0, column]])
