"""Natural units in high precision, from the grains' material; not by way of the engine.

m = rho pi eps D^2/4, mu = Br V/mu0, F* = mu0 mu^2/(pi D^4), tau = sqrt(m D/F*) [D, 2.2], with the
source's mu0 = 4 pi 1e-7 H/m. A slip in the engine's own conversion would show as an error that no
step makes smaller.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from granular.schema.parts import Grains

DIGITS = 50
"""Working precision; the results keep more than thirty digits of it."""

Number = Any
"""A number of mpmath, which has no types of its own."""


class Units(NamedTuple):
    """Sizes of the natural units in SI, for grains of the first species."""

    length: Number
    mass: Number
    force: Number
    time: Number

    @property
    def velocity(self) -> Number:
        return self.length / self.time

    @property
    def acceleration(self) -> Number:
        return self.force / self.mass


def natural_units(grains: Grains) -> Units:
    """The natural units; to be called within mpmath's working precision."""
    from mpmath import mpf, pi, sqrt

    diameter = mpf(grains.species[0].diameter)
    permeability = 4 * pi / 10**7
    volume = pi * mpf(grains.thickness) * diameter**2 / 4
    moment = mpf(grains.remanence) * volume / permeability
    force = permeability * moment**2 / (pi * diameter**4)
    mass = mpf(grains.density) * volume
    return Units(diameter, mass, force, sqrt(mass * diameter / force))
