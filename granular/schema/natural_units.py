"""Natural units of the compiled loop, and their conversion to and from SI.

The units of length D and mass m are the diameter and mass of a grain of the first species; the force unit is
F* = mu0 mu^2 / (pi D^4), with the moment mu of such a grain, and the time unit is tau = sqrt(m D / F*) [D,
2.2; section "Scales" of the model]. In these units the coefficient of the pair force is 3/4, and the
coefficient of the experimental wall's force is 1/2.
"""

from __future__ import annotations

import dataclasses
import math

from granular.parts.magnets import MAGNETIC_CONSTANT
from granular.schema.apparatus import Grains
from granular.schema.units import unit_size


@dataclasses.dataclass(frozen=True)
class Scales:
    """Sizes of the natural units in SI.

    Attributes
    ----------
    length, mass, force : float
        D [m], m [kg], F* [N].
    current : float
        mu/D^2 [A], with the moment mu of a grain of the first species.

    Examples
    --------
    >>> from granular import load_scene
    >>> from granular.schema import Scales
    >>> scales = Scales.from_grains(load_scene("bed").grains)
    >>> round(scales.force, 3), scales.length  # [N], [m]
    (2.377, 0.006)
    """

    length: float
    mass: float
    force: float
    current: float = 1.0

    @classmethod
    def from_grains(cls, grains: Grains) -> Scales:
        """Compute the natural units of a bed from the properties of its first species [D, 2.2].

        Parameters
        ----------
        grains : Grains
            Grains of the bed.

        Returns
        -------
        Scales
            Sizes of the natural units in SI.
        """
        diameter = grains.species[0].diameter
        thickness, density = (float(grains.species_values(name)[0]) for name in ("thickness", "density"))
        volume = math.pi * thickness * diameter**2 / 4.0
        moment = grains.magnets_in_species()[0].moment
        force = MAGNETIC_CONSTANT * moment**2 / (math.pi * diameter**4)
        return cls(diameter, density * volume, force, moment / diameter**2)

    def natural_unit(self, unit: str) -> float:
        """Return the size, in SI, of the natural unit that corresponds to an SI unit.

        Parameters
        ----------
        unit : str
            SI unit, such as ``m/s``.

        Returns
        -------
        float
            Size of the natural unit in that SI unit.
        """
        length, mass, time, current = unit_size(unit)[1]
        return float(self.length**length * self.mass**mass * self.time**time * self.current**current)

    @property
    def permeability(self) -> float:
        """Magnetic constant mu0 [H/m]."""
        return MAGNETIC_CONSTANT

    @property
    def time(self) -> float:
        """Natural unit of time, tau = sqrt(m D / F*) [s]."""
        return math.sqrt(self.mass * self.length / self.force)

    @property
    def velocity(self) -> float:
        """D/tau, the natural unit of velocity [m/s]."""
        return self.length / self.time

    @property
    def rate(self) -> float:
        """1/tau, the natural unit of rates and angular frequencies [1/s]."""
        return 1.0 / self.time

    @property
    def acceleration(self) -> float:
        """F*/m = D/tau^2, the natural unit of acceleration [m/s^2]."""
        return self.force / self.mass

    @property
    def energy(self) -> float:
        """F* D, the natural unit of energy [J]."""
        return self.force * self.length
