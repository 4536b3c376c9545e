"""The elliptic function that an undamped Duffing oscillator moves by: one motion, two names.

Jacobi's functions of W t solve y'' = -k y - beta y^3: A cn(W t | m) where a spring stiffens or goes
through both of two wells, A sn(W t | m) where it softens, and A dn(W t | m) within one of two wells
(Kovacic & Brennan 2011, doi:10.1002/9780470977859, ch. 3).
"""

from __future__ import annotations

import math
from typing import NamedTuple


class EllipticMotion(NamedTuple):
    """z(t) = rest + amplitude * function(rate t + phase | m).

    Attributes
    ----------
    function : str
        ``"cn"``, ``"sn"`` or ``"dn"``.
    rest, amplitude : float
        [m]
    rate : float
        [rad/s]
    m : float
        The parameter k^2, from 0 to 1.
    """

    function: str
    rest: float
    amplitude: float
    rate: float
    m: float

    def text(self, digits: int = 4) -> str:
        """The motion as a formula, at any phase."""
        numbers = (f"{value:.{digits}g}" for value in (self.amplitude, self.rate, self.m))
        amplitude, rate, m = numbers
        rest = f"{self.rest:.{digits}g} + " if abs(self.rest) > 1e-3 * abs(self.amplitude) else ""
        return f"z(t) = {rest}{amplitude} {self.function}({rate} t + phase | {m})"


def elliptic_motion(
    k: float, beta: float, rest: float, z0: float, v0: float
) -> EllipticMotion | None:
    """The motion of z'' + k (z - rest) + beta (z - rest)^3 = 0 from z0 with the velocity v0.

    Parameters
    ----------
    k, beta : float
        [1/s^2], [1/(m^2 s^2)], of either sign.
    rest, z0, v0 : float
        [m], [m], [m/s]

    Returns
    -------
    EllipticMotion or None
        None where the motion is not periodic: at rest, on the hump, or beyond a barrier.
    """
    swing = z0 - rest
    energy = 0.5 * v0**2 + 0.5 * k * swing**2 + 0.25 * beta * swing**4
    square = k**2 + 4.0 * beta * energy
    if not square > 0.0:
        return None
    root = math.sqrt(square)
    if k < 0.0 and energy < 0.0 < beta:
        # Within a well: the outer turning point is the amplitude.
        amplitude = math.copysign(math.sqrt((root - k) / beta), swing)
        rate2 = 0.5 * (root - k)
        return EllipticMotion("dn", rest, amplitude, math.sqrt(rate2), 2.0 + k / rate2)
    if not energy > 0.0 or not root + k > 0.0:
        return None
    amplitude2 = 4.0 * energy / (root + k)
    if beta >= 0.0:
        m = 0.5 * beta * amplitude2 / root
        return EllipticMotion("cn", rest, math.sqrt(amplitude2), math.sqrt(root), m)
    rate2 = k + 0.5 * beta * amplitude2
    if not rate2 > 0.0 or swing**2 > amplitude2 * (1.0 + 1e-9):
        return None  # beyond the barrier, or on it
    m = -0.5 * beta * amplitude2 / rate2
    return EllipticMotion("sn", rest, math.sqrt(amplitude2), math.sqrt(rate2), m)
