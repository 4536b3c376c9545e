"""A cell that is shaken: seen from the cell, gravity swings.

The cell moves as X sin(2 pi f t) along a direction; in its frame every mass feels the acceleration
+X (2 pi f)^2 sin(2 pi f t) along it. The force has the time-dependent energy -m A(t) . r, whose
change with time is the work done by the shaker. Drag and friction act on the velocity relative to
the cell.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from granular.compiled import Array, compiled
from granular.scene.scales import Scales
from granular.scene.schema import Section, quantity


class Shaking(Section):
    """Sinusoidal motion of the whole cell.

    Attributes
    ----------
    amplitude : float
        X [m]
    frequency : float
        f [Hz]
    angle : float
        Direction of the motion, from the horizontal [rad]; vertical by default.
    """

    amplitude: float = quantity("m", least=0.0)
    frequency: float = quantity("Hz", above=0.0)
    angle: float = quantity("1", default=math.pi / 2.0)

    def kernel(self, scales: Scales) -> Swing:
        """The apparent acceleration in natural units."""
        omega = 2.0 * math.pi * self.frequency * scales.time
        size = self.amplitude / scales.length * omega**2
        return Swing(size * math.cos(self.angle), size * math.sin(self.angle), omega)


class Swing(NamedTuple):
    """Apparent acceleration (x, y) sin(omega t), in natural units."""

    x: float
    y: float
    omega: float

    @property
    def greatest_speed(self) -> float:
        """Greatest speed of the cell [D/tau]."""
        return math.hypot(self.x, self.y) / self.omega


@compiled
def acceleration(swing: Swing | None, time: float) -> tuple[float, float]:
    """Apparent acceleration at a time [tau]."""
    if swing is None:
        return 0.0, 0.0
    phase = math.sin(swing.omega * time)
    return swing.x * phase, swing.y * phase


@compiled
def acceleration_rate(swing: Swing | None, time: float) -> tuple[float, float]:
    """Rate of change of the apparent acceleration at a time [tau]."""
    if swing is None:
        return 0.0, 0.0
    phase = swing.omega * math.cos(swing.omega * time)
    return swing.x * phase, swing.y * phase


@compiled(inline=True)
def add_inertia(
    swing: Swing | None, time: float, count: int, masses: Array | None, fx: Array, fy: Array
) -> None:
    """Add the apparent forces."""
    if swing is not None:
        ax, ay = acceleration(swing, time)
        for i in range(count):
            mass = 1.0
            if masses is not None:
                mass = masses[i]
            fx[i] += mass * ax
            fy[i] += mass * ay


@compiled
def mass_moment(count: int, masses: Array | None, x: Array, y: Array) -> tuple[float, float]:
    """Sum of m r over the grains."""
    total_x = 0.0
    total_y = 0.0
    for i in range(count):
        mass = 1.0
        if masses is not None:
            mass = masses[i]
        total_x += mass * x[i]
        total_y += mass * y[i]
    return total_x, total_y
