"""Drag of discs, of the piston's blade and of its guide in a viscous liquid.

In a thin film the liquid is sheared evenly: a face of the area A at the distance h from a wall that stands
still has the drag eta A/h. All of them are of films much thinner than wide, and of slow motions
(rho v h^2/(eta l) small).
"""

from __future__ import annotations

import math


def disc_drag(viscosity: float, area: float, films: tuple[float, float]) -> float:
    """Drag of a disc between two plates [kg/s]; viscosity [Pa s], area of a face [m^2], both films [m]."""
    return viscosity * area * (1.0 / films[0] + 1.0 / films[1])


def counter_flow_factor(packing: float, thickness: float, films: tuple[float, float]) -> float:
    """Factor of the drag of discs that move together, as liquid flows back between them; lengths [m].

    Discs of the area fraction ``packing``, and half of the films, carry liquid along; as much flows back
    between the discs at u = v packing (E + h)/(2 (1 - packing) E), which takes 12 eta u^2/E^2 a volume.
    """
    gap = thickness + films[0] + films[1]
    back = 3.0 * packing / (1.0 - packing) * (gap + thickness) ** 2 / gap**3
    return 1.0 + back / (1.0 / films[0] + 1.0 / films[1])


def blade_drag(viscosity: float, width: float, depth: float, film: float) -> float:
    """Drag of a blade that dips into the liquid, by the films on both its faces [kg/s]; lengths [m]."""
    return 2.0 * viscosity * width * depth / film


def blade_displacement_drag(
    viscosity: float, width: float, depth: float, thickness: float, film: float
) -> float:
    """Drag of the same blade if all liquid that it displaces must pass its films [kg/s]; lengths [m]."""
    # A flow of width thickness v through two films has the gradient 12 eta (thickness v/(2 film))/film^2.
    return 6.0 * viscosity * width * depth * thickness**2 / film**3


def guide_drag(
    viscosity: float, diameter: float, length: float, clearance: float, eccentricity: float = 0.0
) -> float:
    """Drag of a rod in a bush full of liquid [kg/s]; lengths [m], radial clearance, its part off centre."""
    # Shear between two parallel cylinders whose axes are e apart has the resistance a length of two
    # such conductors: 2 pi eta/arcosh((r1^2 + r2^2 - e^2)/(2 r1 r2)).
    inner, outer = 0.5 * diameter, 0.5 * diameter + clearance
    x = clearance**2 * (1.0 - eccentricity**2) / (2.0 * inner * outer)
    return 2.0 * math.pi * viscosity * length / math.log1p(x + math.sqrt(x * (2.0 + x)))
