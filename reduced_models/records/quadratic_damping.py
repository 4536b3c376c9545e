"""Coefficients of a quadratic damping straight from a record, by its weak form.

Every damping that depends on the height alone is a total derivative, and the equation of motion is
integrated against smooth bumps that vanish with their derivatives at both ends: no derivative of
the data is taken, and the coefficients follow by linear least squares (Messenger & Bortz 2021,
doi:10.1137/20M1343166).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

_WIDTH = 0.6  # half-width of a bump, in periods
_POWER = 4  # of the bump (1 - s^2)^4
_MOST_BUMPS = 512


class QuadraticDamping(NamedTuple):
    """u'' + (c0 + c1 u + c2 u^2) u' + stiffness u = force.

    Attributes
    ----------
    damping : float64 (3,)
        c0, c1, c2.
    stiffness, force : float
    unexplained : float
        Share of the bumps' weighted accelerations that the law leaves over, from 0 to 1.
    """

    damping: np.ndarray
    stiffness: float
    force: float
    unexplained: float


def quadratic_damping(time: np.ndarray, u: np.ndarray, period: float) -> QuadraticDamping:
    """Fit a quadratic damping and a linear spring to a swing u (n,) at times (n,)."""
    half = min(_WIDTH * period, 0.3 * float(time[-1] - time[0]))
    count = int(np.clip(8 * (time[-1] - time[0]) / half, 16, _MOST_BUMPS))
    centres = np.linspace(time[0] + half, time[-1] - half, count)
    powers = np.stack([u, u**2 / 2.0, u**3 / 3.0, -u, np.ones_like(u)])
    rows, targets = np.empty((count, 5)), np.empty(count)
    for k, centre in enumerate(centres):
        inside = slice(*np.searchsorted(time, (centre - half, centre + half)))
        bump, slope, curvature = _bump((time[inside] - centre) / half)
        weights = np.stack([slope / half, slope / half, slope / half, bump, bump])
        rows[k] = np.trapezoid(weights * powers[:, inside], time[inside], axis=1)
        targets[k] = np.trapezoid(curvature / half**2 * u[inside], time[inside])
    size = np.maximum(np.abs(rows).max(axis=0), 1e-300)
    found = np.linalg.lstsq(rows / size, targets, rcond=1e-12)[0] / size
    left = targets - rows @ found
    unexplained = float(left @ left / max(float(targets @ targets), 1e-300))
    return QuadraticDamping(found[:3], float(found[3]), float(found[4]), unexplained)


def _bump(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(1 - s^2)^p and its first two derivatives."""
    p, rest = _POWER, np.maximum(1.0 - s * s, 0.0)
    slope = -2.0 * p * s * rest ** (p - 1)
    curvature = 2.0 * p * rest ** (p - 2) * (2.0 * (p - 1) * s * s - rest)
    return rest**p, slope, curvature
