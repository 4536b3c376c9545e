"""Gradient of an external magnetic field, which pulls on moments normal to the plane.

A dipole mu along z in a field B_z = g_x x + g_y y has the energy -mu B_z and feels the force mu (g_x, g_y)
[Jackson, Classical Electrodynamics (1999), 5.7]. A uniform field exerts no force.
"""

from __future__ import annotations

from typing import Any, ClassVar

from granular.effects.custom import effect
from granular.effects.custom_law import Grain
from granular.schema.sections import quantity


@effect
class Gradient:
    """Uniform gradient of the field component along the moments."""

    example: ClassVar[Any] = {"x": "0.05 T/m", "y": "-0.1 T/m"}

    x: float = quantity("T/m", default=0.0)
    y: float = quantity("T/m", default=0.0)

    @staticmethod
    def energy(p: Any, grain: Grain, time: float) -> Any:
        """Energy -mu (g_x x + g_y y) of a grain in the gradient [F* D]; time [tau]."""
        return -grain.moment * (p.x * grain.x + p.y * grain.y)

    @staticmethod
    def force(p: Any, grain: Grain, time: float) -> tuple[Any, Any]:
        """Force mu (g_x, g_y) on a grain in the gradient [F*]; time [tau]."""
        return grain.moment * p.x, grain.moment * p.y
