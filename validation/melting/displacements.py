"""What the displacements from the lattice say: elastic moduli, and the Lindemann parameter."""

from __future__ import annotations

import math

import numpy as np

from validation.melting.neighbours import nearest, neighbours
from validation.melting.scenes import Layer

LONGEST_WAVE = 1.0
"""Greatest wave number of the modes that moduli are extrapolated from, times the spacing."""


def waves(periods: tuple[float, float], most: float) -> np.ndarray:
    """Wave vectors of a periodic cell up to a wave number [1/m], float (m, 2): one of q and -q."""
    unit = 2.0 * np.pi / np.array(periods)
    reach = np.floor(most / unit).astype(int)
    columns, rows = np.meshgrid(np.arange(reach[0] + 1), np.arange(-reach[1], reach[1] + 1))
    half = (columns > 0) | (rows > 0)
    found = np.stack([columns[half], rows[half]], axis=1) * unit
    return found[np.hypot(*found.T) <= most]


def mode_squares(
    frames: np.ndarray, sites: np.ndarray, vectors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """|u(q)|^2 along q and across it, of every frame, float (f, m) each [m^2].

    u(q) = N^(-1/2) sum_j u_j exp(-i q R_j), with the displacements u_j from the sites R_j.

    Parameters
    ----------
    frames : float (f, n, 2)
        Positions that were not brought back into the cell [m].
    sites : float (n, 2)
        [m]
    vectors : float (m, 2)
        Wave vectors [1/m].
    """
    moved = frames - sites
    moved = moved - moved.mean(axis=1, keepdims=True)
    phase = np.exp(-1j * sites @ vectors.T) / math.sqrt(len(sites))
    modes = np.einsum("fnk,nm->fmk", moved, phase, optimize=True)
    along = vectors / np.hypot(*vectors.T)[:, None]
    across = along[:, ::-1] * [-1.0, 1.0]
    first, second = (
        np.abs(np.einsum("fmk,mk->fm", modes, way)) ** 2 for way in (along, across)
    )  # fmt: skip
    return first, second


def modulus(layer: Layer, along: np.ndarray, across: np.ndarray, vectors: np.ndarray) -> float:
    """K = 4 B mu/(B + mu) a^2/T from the mean squares of the modes, at q = 0.

    By equipartition <|u(q)|^2> = rho T/(M q^2), with the shear modulus mu as M across q and B + mu
    along it (von Gruenberg, Keim, Zahn and Maret, Phys. Rev. Lett. 93, 255703, 2004). Both are
    extrapolated to q = 0: the first by a line in q^2, the second by one in q, since the sound of
    grains that repel with r^-3 is no analytic function of q^2.

    Parameters
    ----------
    layer : Layer
    along, across : float (m,)
        [m^2]
    vectors : float (m, 2)
        [1/m]
    """
    q = np.hypot(*vectors.T)
    scale = layer.density * layer.temperature / q**2
    shear = _at_zero(q**2, scale / across)
    both = _at_zero(q, scale / along)
    bulk = both - shear
    if shear <= 0.0 or bulk <= 0.0:
        return 0.0
    return 4.0 * bulk * shear / (bulk + shear) * layer.spacing**2 / layer.temperature


def _at_zero(x: np.ndarray, values: np.ndarray) -> float:
    """Where a line through values, each with an error that is a share of it, meets 0."""
    design = np.stack([np.ones_like(x), x], axis=1) / values[:, None]
    found, *_ = np.linalg.lstsq(design, np.ones_like(x), rcond=None)
    return float(found[0])


def lindemann(
    frames: np.ndarray, periods: tuple[float, float], spacing: float, lags: np.ndarray,
    every: int = 10,
) -> np.ndarray:  # fmt: skip
    """Dynamic Lindemann parameter <|du_i - du_j|^2>/(2 a^2) over neighbours, float (k,).

    As `granular.observables.lindemann_parameter`, in a periodic cell.

    Parameters
    ----------
    frames : float (f, n, 2)
        Positions that were not brought back into the cell [m].
    periods : (float, float)
        [m]
    spacing : float
        a [m].
    lags : int (k,)
        In frames.
    every : int
        Frames from one origin of time to the next.
    """
    totals, numbers = np.zeros((2, len(lags)))
    for first in range(0, len(frames) - int(lags[0]), every):
        found = neighbours(frames[first], periods)
        for k, lag in enumerate(lags):
            if first + lag < len(frames):
                moved = frames[first + lag] - frames[first]
                apart = moved[found.second] - moved[found.first]
                totals[k] += (apart**2).sum()
                numbers[k] += len(apart)
    return np.asarray(totals / (2.0 * spacing**2 * numbers))


def is_crystal(frames: np.ndarray, sites: np.ndarray, periods: tuple[float, float]) -> float:
    """Share of the grains that are nearest to a site of their own in the last frame.

    ``sites`` are those that they began at; the whole crystal may have moved.
    """
    from scipy.spatial import cKDTree

    moved = nearest(frames[-1] - sites, periods)
    drift = (frames[-1] - sites).mean(axis=0) if np.isfinite(moved).all() else 0.0
    places = np.mod(frames[-1] - drift, periods)
    tree = cKDTree(np.mod(sites, periods), boxsize=periods)
    _, nearest_site = tree.query(places)
    return float((nearest_site == np.arange(len(sites))).mean())
