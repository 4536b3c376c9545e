"""Viscous drag: the force -gamma v on a grain of the first species [D, eq. 4.4].

The source scales gamma with the mass ratio [D, eq. 4.16], so that the acceleration is
-(gamma/m) v for every species.

Drag dissipates and is not smuggled into a kick as one more force, which would cost the second
order: kick and drag are solved together, exactly, while the positions stand still. With the
acceleration a and the rate c,

    v(s) = e^(-c s) v + (1 - e^(-c s))/c a,
    energy lost per mass = integral of c v^2 = A v^2 + B v a + C a^2,

which holds for any c s: an overdamped grain moves at its terminal velocity a/c.
"""

from __future__ import annotations

import math

from granular.compiled import compiled, entry
from granular.scene.scales import Scales
from granular.scene.schema import Section, quantity


class Drag(Section):
    """Viscous drag on every grain.

    Attributes
    ----------
    coefficient : float
        gamma [kg/s] of a grain of the first species.
    """

    coefficient: float = quantity("kg/s", default=0.1, least=0.0)

    def kernel(self, scales: Scales) -> float:
        """Decay rate c = gamma tau / m of the velocity, in natural units."""
        return self.coefficient * scales.time / scales.mass


@entry
def flow(rate: float, span: float) -> tuple[float, float, float, float, float]:
    """Coefficients of the exact flow of kick and drag over ``span``.

    Returns
    -------
    tuple of float
        Decay of v, gain of v from a, and A, B, C of the energy lost per mass.
    """
    z = rate * span
    decay = math.exp(-z)
    gain = -math.expm1(-z) / rate if z != 0.0 else span
    a = -0.5 * math.expm1(-2.0 * z)
    b = rate * gain * gain
    if abs(z) < 1e-2:
        # The closed form of C cancels here; this is its series.
        bent = 1.0 / 3.0 - z * (1.0 / 4.0 - z * (7.0 / 60.0 - z * (1.0 / 24.0 - z * 31.0 / 2520.0)))
        c = rate * span * span * span * bent
    else:
        c = (span - 2.0 * gain + a / rate) / rate
    return decay, gain, a, b, c


@compiled
def way(rate: float, span: float, gain: float, speed: float, push: float) -> float:
    """Way in ``span`` from a speed, under drag and an acceleration; ``gain`` as `flow` has it."""
    bend = (span - gain) / rate if rate * span > 1e-6 else 0.5 * span * span
    return gain * speed + bend * push


@compiled
def stopping_way(rate: float, speed: float, brake: float) -> float:
    """Way to rest under drag and the deceleration ``brake``.

    With the time of the stop t, e^(c t) = 1 + c v/brake, it is v/c - brake t/c.
    """
    if rate * speed <= 1e-6 * brake:
        return 0.5 * speed * speed / brake
    if brake <= 0.0:
        return speed / rate
    return (speed - brake / rate * math.log1p(rate * speed / brake)) / rate


@compiled
def stopping_time(rate: float, speed: float, brake: float) -> float:
    """Time to rest under drag and the deceleration ``brake``: log(1 + c v/brake)/c."""
    if rate * speed <= 1e-6 * brake:
        return speed / brake
    return math.log1p(rate * speed / brake) / rate
