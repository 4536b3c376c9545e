"""Elastic moduli and Lindemann parameter from displacements relative to the lattice."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from research.melting.neighbours import nearest_image_displacements, periodic_voronoi_neighbours
from research.melting.scenes import Layer

LONGEST_WAVE = 1.0
"""Maximum wave number of the modes used to extrapolate moduli, times the spacing."""


def wave_vectors_of_cell(periods: tuple[float, float], maximum: float) -> np.ndarray:
    """Return wave vectors of a periodic cell up to a wave number [1/m], float (m, 2): one of q and -q."""
    unit = 2.0 * np.pi / np.array(periods)
    reach = np.floor(maximum / unit).astype(int)
    columns, rows = np.meshgrid(np.arange(reach[0] + 1), np.arange(-reach[1], reach[1] + 1))
    half = (columns > 0) | (rows > 0)
    result = np.stack([columns[half], rows[half]], axis=1) * unit
    return result[np.hypot(*result.T) <= maximum]


class GrainsOnLatticeSites(NamedTuple):
    """Grains of a frame with their nearest lattice sites.

    Attributes
    ----------
    site : int (n,)
    moved : float (n, 2)
        Displacement from the site [m].
    order : float
        Translational order: mean size of the three shortest Fourier components of the density at
        the lattice's reciprocal vectors, over the number of grains. 1 in a perfect crystal.
    """

    site: np.ndarray
    moved: np.ndarray
    order: float


def assign_grains_to_sites(
    positions: np.ndarray, sites: np.ndarray, periods: tuple[float, float], spacing: float
) -> GrainsOnLatticeSites:
    """Assign grains to the sites of a crystal that may have moved as a whole.

    Near melting, grains exchange sites while the density of the crystal is constant. Each grain is therefore
    assigned to its present site, not to its initial site. The position of the lattice follows from the phases
    of its Fourier components.

    Parameters
    ----------
    positions : float (n, 2)
        [m]
    sites : float (n, 2)
        Sites of a hexagonal lattice with rows along x [m].
    periods : (float, float)
        [m]
    spacing : float
        Spacing of the lattice [m].
    """
    from scipy.spatial import cKDTree

    wave = 2.0 * np.pi / spacing
    vectors = wave * np.array(
        [[1.0, -1.0 / math.sqrt(3.0)], [0.0, 2.0 / math.sqrt(3.0)], [1.0, 1.0 / math.sqrt(3.0)]]
    )
    parts = np.exp(1j * (positions @ vectors.T)).mean(axis=0)
    at_sites = np.exp(1j * (sites @ vectors.T)).mean(axis=0)
    phases = np.angle(parts[:2] / at_sites[:2])
    shift = np.linalg.solve(vectors[:2], phases)
    inside = np.mod(positions - shift, periods)
    inside = np.where(inside < periods, inside, 0.0)
    _, site = cKDTree(np.mod(sites, periods), boxsize=periods).query(inside)
    return GrainsOnLatticeSites(
        site, nearest_image_displacements(inside - sites[site], periods), float(np.abs(parts).mean())
    )


def longitudinal_and_transverse_mode_squares(
    result: Sequence[GrainsOnLatticeSites], sites: np.ndarray, vectors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return |u(q)|^2 along q and across it for every frame, float (f, m) each [m^2].

    u(q) = N^(-1/2) sum_j u_j exp(-i q R_j), with the displacements u_j from the sites R_j.

    Parameters
    ----------
    found : sequence of OnSites
        Assigned sites of each frame.
    sites : float (n, 2)
        [m]
    vectors : float (m, 2)
        Wave vectors [1/m].
    """
    phase = np.exp(-1j * sites @ vectors.T) / math.sqrt(len(sites))
    modes = np.array([phase[item.site].T @ (item.moved - item.moved.mean(axis=0)) for item in result])
    along = vectors / np.hypot(*vectors.T)[:, None]
    across = along[:, ::-1] * [-1.0, 1.0]
    first, second = (np.abs(np.einsum("fmk,mk->fm", modes, way)) ** 2 for way in (along, across))
    return first, second


def lindemann_plateau(
    result: Sequence[GrainsOnLatticeSites], sites: np.ndarray, periods: tuple[float, float], spacing: float
) -> float:
    """Return the limit of the dynamic Lindemann parameter in a crystal without exchange of grains.

    It is <|u_i - u_j|^2>/a^2 over neighbouring sites with one grain each: after a long time the displacements
    of two neighbours are independent of the earlier ones.

    Parameters as of `longitudinal_and_transverse_mode_squares` and `assign_grains_to_sites`.
    """
    pairs = periodic_voronoi_neighbours(sites, periods)
    total, number = 0.0, 0
    for item in result:
        grain = np.zeros(len(sites), dtype=int)
        grain[item.site] = np.arange(len(sites))
        single = np.bincount(item.site, minlength=len(sites)) == 1
        good = single[pairs.first] & single[pairs.second]
        apart = item.moved[grain[pairs.second[good]]] - item.moved[grain[pairs.first[good]]]
        total += float((apart**2).sum())
        number += len(apart)
    return total / (spacing**2 * max(number, 1))


def melting_modulus_from_modes(
    layer: Layer, along: np.ndarray, across: np.ndarray, vectors: np.ndarray
) -> float:
    """Return K = 4 B mu/(B + mu) a^2/T from the mean squares of the modes, extrapolated to q = 0.

    By equipartition <|u(q)|^2> = rho T/(M q^2), with the shear modulus mu as M across q and B + mu along it
    (von Gruenberg, Keim, Zahn and Maret, Phys. Rev. Lett. 93, 255703, 2004). Both are extrapolated to q = 0:
    the first by a line in q^2, the second by one in q, since the sound speed of grains with a repulsion r^-3
    is not an analytic function of q^2.

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
    shear = _line_value_at_zero(q**2, scale / across)
    both = _line_value_at_zero(q, scale / along)
    bulk = both - shear
    if shear <= 0.0 or bulk <= 0.0:
        return 0.0
    return 4.0 * bulk * shear / (bulk + shear) * layer.spacing**2 / layer.temperature


def _line_value_at_zero(x: np.ndarray, values: np.ndarray) -> float:
    """Return the value at x = 0 of a line through values with equal relative errors."""
    design = np.stack([np.ones_like(x), x], axis=1) / values[:, None]
    result, *_ = np.linalg.lstsq(design, np.ones_like(x), rcond=None)
    return float(result[0])


def dynamic_lindemann_parameter(
    frames: np.ndarray, periods: tuple[float, float], spacing: float, lags: np.ndarray, every: int = 10
) -> np.ndarray:
    """Return the dynamic Lindemann parameter <|du_i - du_j|^2>/(2 a^2) over neighbours, float (k,).

    As `granular.observables.lindemann_parameter`, but in a periodic cell.

    Parameters
    ----------
    frames : float (f, n, 2)
        Positions without periodic wrapping [m].
    periods : (float, float)
        [m]
    spacing : float
        a [m].
    lags : int (k,)
        Lags in frames.
    every : int
        Frames between successive time origins.
    """
    totals, numbers = np.zeros((2, len(lags)))
    for first in range(0, len(frames) - int(lags[0]), every):
        result = periodic_voronoi_neighbours(frames[first], periods)
        for k, lag in enumerate(lags):
            if first + lag < len(frames):
                moved = frames[first + lag] - frames[first]
                apart = moved[result.second] - moved[result.first]
                totals[k] += (apart**2).sum()
                numbers[k] += len(apart)
    return np.asarray(totals / (2.0 * spacing**2 * numbers))
