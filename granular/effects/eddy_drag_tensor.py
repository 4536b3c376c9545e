"""Eddy-current drag between two magnets that move along a plate, as a tensor of their distance.

At low speed the currents in each sheet of the plate follow the field of the magnets without delay,
and a magnet feels those of all others. The force on the magnet i is -sum_j T_ij v_j with

    T_ij = (gamma H^4/3) Int_0^inf k^3 w(k) [J1(kr)/(kr) - J2(kr) e e^T] dk,   H = 2h,

where gamma is the drag of a lone dipole over a thin plate, r e the displacement, and w(k) the mean
of exp(-2kz) over the plate: two exponentials of the distance, of field and of reaction. As the
Fourier transform of k k^T w(k) >= 0 it never gives energy. Of a thin plate, w = exp(-kH),

    T_ij = gamma (H^2/s)^(5/2) [1 - 5 r r^T/s],   s = r^2 + H^2:

two receding images [Maxwell 1872; Reitz 1970, doi:10.1063/1.1659172].
"""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.polynomial import Chebyshev

from granular.pairs.disc_law import Disc

if TYPE_CHECKING:
    from jaxtyping import Float

# 1e-13 holds if the face of a thick plate is 0.17 D or farther from the grains' middle; 4e-8 at 0.1 D.
ORDER = 64
"""Coefficients of each series: hold the tensor to 1e-13 of a lone grain's drag."""

FARTHEST = 30.0
"""Distance [D] up to which the series are fitted, and reach in a periodic cell: a grain farther away brakes
by less than 1e-5."""

# A cosine over this phase is integrated to 1e-14, over 40 to 3e-13.
_PANEL = 20.0
"""Phase that 24 nodes of Gauss's rule resolve to the last digit."""


class Plate(NamedTuple):
    """A plate below the grains."""

    distance: float  # [D], from the grains' middle to the plate's
    thickness: float  # [D]; 0: a thin plate

    def thickness_drag_factor(self) -> float:
        """Drag of a lone dipole over that along a thin plate of the same sheet conductance."""
        h, half = self.distance, 0.5 * self.thickness
        if half == 0.0:
            return 1.0
        return h**4 * ((h - half) ** -3 - (h + half) ** -3) / (6.0 * half)


def drag_tensor(
    plate: Plate, r: Float[np.ndarray, "n"], discs: tuple[Disc, ...] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Isotropic and radial part (n,) of the drag tensor, over a lone dipole's along a thin plate; r [D]."""
    from scipy.special import j0, j1

    h, half = plate.distance, 0.5 * plate.thickness
    # exp(-45) = 3e-20: what the integral has beyond is below rounding.
    longest = 45.0 / (2.0 * (h - half) - 0.5 * sum(disc.height for disc in discs))
    panels = 8 + math.ceil(longest * float(np.max(r, initial=1.0)) / _PANEL)
    nodes, weights = np.polynomial.legendre.leggauss(24)
    width = longest / panels
    k = (width * (np.arange(panels)[:, None] + 0.5 * (nodes + 1.0))).ravel()
    density = np.exp(-2.0 * k * h) * (np.sinh(2.0 * k * half) / (2.0 * k * half) if half else 1.0)
    density *= np.tile(0.5 * width * weights, panels) * (2.0 * h) ** 4 / 3.0 * k**3
    for disc in discs:
        across, along = k * disc.radius, 0.5 * k * disc.height
        density *= 2.0 * j1(across) / across * np.sinh(along) / along
    isotropic, radial = np.empty((2, len(r)))
    for index, distance in enumerate(r):
        phase = k * distance
        first = np.where(phase > 1e-6, j1(phase) / np.maximum(phase, 1e-6), 0.5)
        # J2 = 2 J1/x - J0 cancels below; x^2/8 is its series to 1e-7.
        second = np.where(phase > 1e-3, 2.0 * first - j0(phase), phase * phase / 8.0)
        isotropic[index], radial[index] = density @ first, -(density @ second)
    return isotropic, radial


@cache
def lone_disc_drag_factor(plate: Plate, disc: Disc) -> float:
    """Drag of a lone disc over that of a dipole along a thin plate."""
    return float(drag_tensor(plate, np.zeros(1), (disc, disc))[0][0])


@cache
def _fit_drag_tensor(plate: Plate, discs: tuple[Disc, ...]) -> tuple[Chebyshev, Chebyshev]:
    """Series P, Q in T = u^(5/2) [P(u) - 5 Q(u) r r^T/s], u = H^2/s."""
    square = 4.0 * plate.distance**2
    least = square / (square + FARTHEST**2)
    u = least + (1.0 - least) * 0.5 * (np.polynomial.chebyshev.chebpts1(ORDER) + 1.0)
    r = np.sqrt(square / u - square)
    isotropic, radial = drag_tensor(plate, r, discs)
    across, along = isotropic / u**2.5, -radial * square / (5.0 * r * r * u**3.5)
    domain = [least, 1.0]
    return Chebyshev.fit(u, across, ORDER - 1, domain), Chebyshev.fit(u, along, ORDER - 1, domain)


def drag_tensor_of_squares(
    plate: Plate, squares: Float[np.ndarray, "n"], discs: tuple[Disc, ...] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Isotropic part (n,) of the drag tensor, and the radial one over r^2 [1/D^2]; squares r^2 [D^2]."""
    square = 4.0 * plate.distance**2
    u = square / (square + squares)
    p, q = np.ones_like(u), np.ones_like(u)
    if plate.thickness > 0.0 or discs:
        p, q = (series(u) for series in _fit_drag_tensor(plate, discs))
    return u**2.5 * p, -5.0 / square * u**3.5 * q


@cache
def lattice_drag_factor(plate: Plate, spacing: float) -> float:
    """Drag of a triangular lattice that moves as one body, per grain, over a lone grain's; spacing [D]."""
    # The rest, about pi rho H^5/R^3, is 1e-4 for the packaged damper's spacing and H = 4/3 D.
    reach = 40
    i, j = np.meshgrid(np.arange(-2 * reach, 2 * reach + 1), np.arange(-reach, reach + 1))
    r = spacing * np.hypot(i + 0.5 * j, math.sqrt(0.75) * j).ravel()
    r = r[r < reach * spacing * math.sqrt(0.75)]
    across, along = drag_tensor_of_squares(plate, r * r)
    # Averaged over directions, e e^T is one half.
    return float((across + 0.5 * r * r * along).sum()) / plate.thickness_drag_factor()
