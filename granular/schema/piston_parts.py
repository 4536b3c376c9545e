"""Parts of the piston from which its viscous drag follows."""

from __future__ import annotations

from granular.parts.drags import blade_drag, guide_drag
from granular.parts.liquids import find_liquid
from granular.schema.field_kinds import FieldError, at_key
from granular.schema.sections import Section, integer_field, quantity, text_field
from granular.shared.errors import InputError


class Blade(Section):
    """The part of the piston that dips into the liquid, between the plates and as wide as the cell.

    Attributes
    ----------
    depth : float
        Depth that it dips in [m].
    film : float
        Thickness of the liquid between each of its faces and the plate [m].
    """

    depth: float = quantity("m", above=0.0)
    film: float = quantity("m", above=0.0)

    def drag(self, width: float, separation: float, viscosity: float) -> float:
        """Drag of both faces [kg/s]; width and gap of the cell [m], viscosity of the liquid [Pa s]."""
        if 2.0 * self.film >= separation:
            words = f"{self.film:g} m must be below half of cell.separation, {0.5 * separation:g} m"
            raise FieldError(words, "piston", "blade", "film")
        return blade_drag(viscosity, width, self.depth, self.film)


class Guide(Section):
    """Rods in bushes that guide the piston.

    Attributes
    ----------
    diameter, length : float
        Diameter of a rod, and length of its bush [m].
    clearance : float
        Radius of the bush less that of the rod [m].
    eccentricity : float
        Distance of their axes over the clearance.
    count : int
        Number of rods.
    liquid : str or None
        Liquid in the bush; that of the cell without.
    """

    diameter: float = quantity("m", above=0.0)
    length: float = quantity("m", above=0.0)
    clearance: float = quantity("m", above=0.0)
    eccentricity: float = quantity("1", default=0.0, least=0.0, below=1.0)
    count: int = integer_field(default=1, least=1)
    liquid: str | None = text_field(default=None, optional=True)

    def drag(self, temperature: float, viscosity: float | None) -> float:
        """Drag of all rods [kg/s]; temperature of the liquid [deg C], viscosity of the cell's one [Pa s]."""
        if self.liquid is not None:
            with at_key("piston", "guide", "liquid", errors=InputError):
                viscosity = find_liquid(self.liquid, temperature).viscosity
        if viscosity is None:
            words = "must be given, as the cell holds no liquid; or give effects.drag.liquid"
            raise FieldError(words, "piston", "guide", "liquid")
        rod = guide_drag(viscosity, self.diameter, self.length, self.clearance, self.eccentricity)
        return self.count * rod
