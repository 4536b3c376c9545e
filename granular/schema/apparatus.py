"""Sections of a scene for the grains, the piston and the output.

The effects (`granular.effects`) act on grains and piston, the arrangement gives their initial state, and the
protocol drives the piston.
"""

from __future__ import annotations

import copy
import math
from fractions import Fraction
from typing import Any

import numpy as np

from granular.parts.liquids import blade_drag_coefficient, find_liquid, guide_drag_coefficient
from granular.parts.magnets import (
    RECOIL_PERMEABILITY,
    REFERENCE_TEMPERATURE,
    Magnet,
    find_grade,
    make_magnet,
    remanence_of_moment,
)
from granular.schema.cell import Cell
from granular.schema.field_kinds import FieldError, add_key_to_errors
from granular.schema.sections import (
    Section,
    choice_field,
    integer_field,
    nested_section_field,
    quantity,
    section_list_field,
    temperature_field,
    text_field,
)
from granular.shared.array_types import Float, Int
from granular.shared.errors import InputError


class Blade(Section):
    """The part of the piston that is immersed in the liquid between the plates, as wide as the cell.

    Attributes
    ----------
    depth : float
        Immersed depth [m].
    film : float
        Thickness of the liquid film between each face of the blade and the plate next to it [m].
    """

    depth: float = quantity("m", above=0.0)
    film: float = quantity("m", above=0.0)

    def drag_coefficient(self, width: float, separation: float, viscosity: float) -> float:
        """Drag of both faces, in kg/s; width and plate separation of the cell in m, viscosity in Pa s."""
        if 2.0 * self.film >= separation:
            words = (
                f"{self.film:g} m must be below half of cell.separation, {0.5 * separation:g} m; reduce it"
            )
            raise FieldError(words, "piston", "blade", "film")
        return blade_drag_coefficient(viscosity, width, self.depth, self.film)


class Guide(Section):
    """Guide of the piston: rods that slide in bushes.

    Attributes
    ----------
    diameter, length : float
        Diameter of a rod, and length of its bush [m].
    clearance : float
        Radius of the bush minus radius of the rod [m].
    eccentricity : float
        Distance between the axes of rod and bush, divided by the clearance.
    count : int
        Number of rods.
    liquid : str or None
        Liquid in the bush; by default the liquid in the cell.
    """

    diameter: float = quantity("m", above=0.0)
    length: float = quantity("m", above=0.0)
    clearance: float = quantity("m", above=0.0)
    eccentricity: float = quantity("1", default=0.0, least=0.0, below=1.0)
    count: int = integer_field(default=1, least=1)
    liquid: str | None = text_field(default=None, optional=True)

    def drag_coefficient(self, temperature: float, viscosity: float | None) -> float:
        """Drag of all rods, in kg/s; temperature in deg C, viscosity of the liquid in the cell in Pa s."""
        if self.liquid is not None:
            with add_key_to_errors("piston", "guide", "liquid", errors=InputError):
                viscosity = find_liquid(self.liquid, temperature).viscosity
        if viscosity is None:
            words = "is missing, and the cell has no liquid; give a liquid here or in effects.drag.liquid"
            raise FieldError(words, "piston", "guide", "liquid")
        rod = guide_drag_coefficient(viscosity, self.diameter, self.length, self.clearance, self.eccentricity)
        return self.count * rod


class Species(Section):
    """One kind of grain: a flat cylinder magnetised along its axis.

    Attributes
    ----------
    name : str
        Name of the species.
    diameter : float
        Diameter of a grain [m].
    share : float
        Fraction of the grains; the fractions of a bed add up to 1.
    thickness, density, remanence : float or None
        Thickness [m], density [kg/m^3] and remanence [T] of the species, if they differ from the values of
        `Grains`.
    """

    name: str = text_field(default="grain")
    diameter: float = quantity("m", above=0.0)
    share: float = quantity("1", default=1.0, least=0.0, most=1.0)
    thickness: float | None = quantity("m", above=0.0, default=None, optional=True)
    density: float | None = quantity("kg/m^3", above=0.0, default=None, optional=True)
    remanence: float | None = quantity("T", above=0.0, default=None, optional=True)


class Grains(Section):
    """Grains of a bed. Defaults as in [D, Table 2.1].

    Attributes
    ----------
    count : int
        Number of grains.
    species : tuple of Species
        Species of grains; the first species determines the natural units.
    thickness : float
        Thickness of a grain [m]. Thickness, density and remanence apply to all species without separate
        values.
    density : float
        Density of a grain [kg/m^3].
    remanence : float
        Residual magnetisation Br [T], at 20 degrees Celsius; 1.3 T if neither grade nor moment is given.
    moment : float or None
        Magnetic moment of a single disc, measured at 20 degrees Celsius [A m^2]; given instead of the
        remanence.
    grade : str or None
        Grade of the magnets, such as ``"N42"``. A grade limits the temperature, and determines remanence (the
        middle of the grade's range) and permeability if these are not given.
    coating : float or None
        Thickness of the non-magnetic coating on faces and rim [m]; diameter and thickness include the
        coating.
    permeability : float or None
        Relative recoil permeability; it determines how much the demagnetising field and the field of
        neighbours reduce the moment.
    spacing : float or None
        Distance [m] between nearest neighbours in a triangular lattice; the field of these neighbours
        reduces the moment. None: no neighbours.
    temperature : float or None
        Temperature of magnets and liquid [deg C]; by default 20 for magnets and 25 for a liquid.
    spread : float
        Relative standard deviation of the grains' moments within a species, truncated at three standard
        deviations. De Paula attributes an asymmetry in the experiment to such a spread.
    seed : int
        Seed of the random numbers of the spread.
    mixing : str
        Order of the species in the initial grid, row by row: ``"interspersed"``, with each species
        evenly distributed and its number given by its fraction; or ``"every-kth"``, de Paula's rule for two
        species [D, 4.2.2]. Every k-th grain belongs to the second species, k = floor(1/R), for a fraction R
        up to 1/2; for larger R every k-th grain belongs to the first, k = floor(1/(1 - R)). The actual
        fractions differ from the given ones (1/2 for every R in (1/3, 1/2]); see `species_fractions`.
    magnets : str
        ``"dipoles"``: point dipoles, as in de Paula's model; or ``"cylinders"``: uniformly magnetised discs
        of each species' diameter and thickness, whose mid-planes lie in one plane. At short
        distances discs repel each other more strongly than dipoles: twice as strongly at contact if the
        thickness is half the diameter.
    """

    unwritten_defaults = ("magnets", "spread")

    count: int = integer_field(most=10**8)
    species: tuple[Species, ...] = section_list_field(Species, least=1)
    # The magnets of [D]: of 6 mm, 0.625 g and 0.0877 A m^2.
    thickness: float = quantity("m", default=0.003, above=0.0)
    density: float = quantity("kg/m^3", default=7368.0, above=0.0)
    remanence: float = quantity("T", default=None, above=0.0, optional=True)
    moment: float | None = quantity("A m^2", default=None, above=0.0, optional=True)
    grade: str | None = text_field(default=None, optional=True)
    coating: float | None = quantity("m", default=None, least=0.0, optional=True)
    permeability: float | None = quantity("1", default=None, least=1.0, optional=True)
    spacing: float | None = quantity("m", default=None, above=0.0, optional=True)
    temperature: float | None = temperature_field()
    spread: float = quantity("1", default=0.0, least=0.0, most=0.3)
    seed: int = integer_field(default=1)
    mixing: str = choice_field("interspersed", "every-kth", default="interspersed")
    magnets: str = choice_field("dipoles", "cylinders", default="dipoles")

    def validate(self) -> None:
        """Check fractions, mixing and magnets; compute the remanence from grade or moment, if given."""
        total = sum(specy.share for specy in self.species)
        if abs(total - 1.0) > 1e-9:
            raise FieldError(f"the shares add up to {total:g}; they must add up to 1", "species")
        if self.spread == 0.0:
            object.__setattr__(self, "seed", 1)  # unused
        if self.mixing == "every-kth" and len(self.species) != 2:
            raise FieldError(
                f"'every-kth' requires 2 species, but there are {len(self.species)}; use 'interspersed'",
                "mixing",
            )
        self._check_magnets()
        self._set_remanence()

    def _check_magnets(self) -> None:
        thinnest = min(float(self.species_values("thickness").min()), *(s.diameter for s in self.species))
        if self.coating is not None and 2.0 * self.coating >= thinnest:
            raise FieldError(
                f"{self.coating:g} m on both sides fills a grain {thinnest:g} m thick or wide; "
                "give a thinner coating",
                "coating",
            )
        if self.spacing is not None and self.permeability is None and self.grade is None:
            raise FieldError("has an effect only with a permeability; give permeability or grade", "spacing")
        if self.spacing is not None and self.spacing < self.species[0].diameter:
            raise FieldError(
                f"{self.spacing:g} m is below the discs' diameter, {self.species[0].diameter:g} m; give a "
                "larger spacing",
                "spacing",
            )
        if self.grade is None:
            return
        with add_key_to_errors("grade", errors=InputError):
            grade = find_grade(self.grade)
        if self.temperature is not None and self.temperature > grade.highest_temperature:
            raise FieldError(
                f"{self.temperature:g} °C exceeds {grade.highest_temperature:g} °C, the limit of "
                f"{grade.name}; use a grade for higher temperatures, such as N42M",
                "temperature",
            )
        if self.permeability is None:
            object.__setattr__(self, "permeability", RECOIL_PERMEABILITY)

    def _set_remanence(self) -> None:
        given, value = self.remanence, 1.3  # of [D]
        if self.moment is not None:
            if len(self.species) > 1 or self.species[0].remanence is not None:
                raise FieldError(
                    "requires a single species without a separate remanence; give the remanence instead",
                    "moment",
                )
            lone = self._magnet_of_species(self.species[0], 1.0, cold=True)
            value = remanence_of_moment(self.moment, lone)
            if given is not None and not math.isclose(given, value):
                raise FieldError(
                    f"gives a remanence of {value:g} T, but remanence = {given:g} T; remove one of them",
                    "moment",
                )
        elif given is not None:
            return
        elif self.grade is not None:
            value = find_grade(self.grade).remanence
        object.__setattr__(self, "remanence", value)

    def _magnet_of_species(self, species: Species, remanence: float, *, cold: bool = False) -> Magnet:
        return make_magnet(
            species.diameter,
            self.thickness if species.thickness is None else species.thickness,
            remanence,
            coating=self.coating or 0.0,
            permeability=self.permeability or 1.0,
            spacing=self.spacing or math.inf,
            temperature=REFERENCE_TEMPERATURE if cold or self.temperature is None else self.temperature,
        )

    def magnets_in_species(self) -> tuple[Magnet, ...]:
        """Return the magnet of each species: the grain without its coating."""
        values = self.species_values("remanence").tolist()
        return tuple(
            self._magnet_of_species(specy, value) for specy, value in zip(self.species, values, strict=True)
        )

    def to_plain(self) -> dict[str, Any]:
        """Return plain data without an unused seed and without values derived from moment or grade."""
        plain = super().to_plain()
        grade = None if self.grade is None else find_grade(self.grade)
        if self.moment is not None or (grade is not None and self.remanence == grade.remanence):
            del plain["remanence"]
        if grade is not None and self.permeability == RECOIL_PERMEABILITY:
            del plain["permeability"]
        if self.spread == 0.0:
            del plain["seed"]
        return plain

    @property
    def liquid_temperature(self) -> float:
        """Temperature of a liquid in the cell [deg C]."""
        return 25.0 if self.temperature is None else self.temperature

    def species_counts(self) -> tuple[int, ...]:
        """Return the number of grains of each species."""
        return tuple(np.bincount(self.species_indices(), minlength=len(self.species)).tolist())

    def species_fractions(self) -> tuple[float, ...]:
        """Actual fraction of the grains of each species, by the mixing rule."""
        return tuple(number / max(self.count, 1) for number in self.species_counts())

    def species_indices(self) -> Int[np.ndarray, "n"]:
        """Index of the species of each grain, by the mixing rule [D, 4.2.2]."""
        if self.mixing == "every-kth":
            return _species_by_every_kth_rule(self.count, self.species[1].share)
        counts = self._largest_remainder_counts()
        indices = [(np.arange(number) + 0.5) / max(number, 1) for number in counts]
        owner = np.repeat(np.arange(len(counts)), counts)
        return owner[np.argsort(np.concatenate(indices), kind="stable")]

    def _largest_remainder_counts(self) -> tuple[int, ...]:
        """Numbers of grains of each species, from their fractions by the largest-remainder method."""
        exact = [self.count * specy.share for specy in self.species]
        # Without 1e-9, 100 times 0.29 would be 28.
        counts = [int(number + 1e-9) for number in exact]
        order = sorted(range(len(exact)), key=lambda k: counts[k] - exact[k])
        for k in order[: self.count - sum(counts)]:
            counts[k] += 1
        return tuple(counts)

    def diameters(self) -> Float[np.ndarray, "n"]:
        """Diameter of each grain [m]."""
        return np.array([specy.diameter for specy in self.species])[self.species_indices()]

    def species_values(self, name: str) -> Float[np.ndarray, "s"]:
        """Return the thickness, density or remanence of each species; ``name`` is one of these words."""
        values = [getattr(specy, name) for specy in self.species]
        return np.array([getattr(self, name) if value is None else value for value in values])

    def masses(self) -> Float[np.ndarray, "n"]:
        """Mass of each grain, a flat cylinder [kg]."""
        sheet = np.pi / 4.0 * self.species_values("density") * self.species_values("thickness")
        value = self.species_indices()
        return np.asarray(sheet[value] * self.diameters() ** 2)

    def mass_ratios(self) -> Float[np.ndarray, "s"]:
        """Mass of a grain of each species relative to the first species."""
        return self._ratios_to_first_species("density")

    def face_area_ratios(self) -> Float[np.ndarray, "s"]:
        """Face area of a grain of each species relative to the first species."""
        diameter = np.array([specy.diameter for specy in self.species])
        return np.asarray((diameter / diameter[0]) ** 2)

    def moment_ratios(self) -> Float[np.ndarray, "s"]:
        """Magnetic moment of a grain of each species, without spread, relative to the first species."""
        if self.coating is None and self.permeability is None:
            return self._ratios_to_first_species("remanence")
        moments = np.array([magnet.moment for magnet in self.magnets_in_species()])
        return moments / moments[0]

    def _ratios_to_first_species(self, name: str) -> np.ndarray:
        thickness, strength = self.species_values("thickness"), self.species_values(name)
        return self.face_area_ratios() * (thickness / thickness[0]) * (strength / strength[0])

    def moment_spread_factors(self) -> Float[np.ndarray, "n"]:
        """Moment of each grain, with spread, relative to the nominal moment of its species."""
        if self.spread == 0.0:
            return np.ones(self.count)
        drawn = np.random.default_rng(self.seed).normal(size=self.count)
        # Truncated at three deviations: with a maximum spread of 0.3 no moment changes sign.
        return np.asarray(1.0 + self.spread * np.clip(drawn, -3.0, 3.0))


def _species_by_every_kth_rule(count: int, fraction: float) -> np.ndarray:
    """Species of each grain by de Paula's rule, with a rational fraction to avoid rounding errors."""
    # 0.6666666666666666 means two thirds: taken exactly, every second grain would be of the rare species.
    rare = Fraction(repr(fraction)).limit_denominator(10**6)
    common, result = 0, 1
    if rare > Fraction(1, 2):
        rare, common, result = 1 - rare, 1, 0
    species = np.full(count, common)
    if rare > 0:
        every = int(1 / rare)
        species[every - 1 :: every] = result
    return species


class Piston(Section):
    """The piston, the top wall of the cell.

    Attributes
    ----------
    height : float
        Initial height [m].
    mass : float or None
        Mass of the piston [kg]; required if it moves freely in a stage.
    drag : float
        Viscous drag coefficient of the free piston [kg/s]. Default: computed from blade and guide, or 0
        without them.
    blade : Blade or None
        Part immersed in the liquid.
    guide : Guide or None
        Rods and bushes.
    friction : float
        Coulomb friction of the free piston [N].
    """

    height: float = quantity("m", above=0.0)
    mass: float | None = quantity("kg", above=0.0, default=None, optional=True)
    drag: float = quantity("kg/s", default=None, least=0.0, optional=True)
    friction: float = quantity("N", default=0.0, least=0.0)
    blade: Blade | None = nested_section_field(Blade, default=None, optional=True)
    guide: Guide | None = nested_section_field(Guide, default=None, optional=True)

    def validate(self) -> None:
        """Check that drag is not given with blade or guide; set it to 0 without them."""
        if self.drag is None:
            object.__setattr__(self, "drag", 0.0)
        elif self.has_parts:
            raise FieldError("is computed from blade and guide, and cannot also be given; remove it", "drag")

    @property
    def has_parts(self) -> bool:
        """True if blade or guide determine the drag."""
        return self.blade is not None or self.guide is not None

    def resolve_parts(self, grains: Grains, cell: Cell, viscosity: float | None) -> Piston:
        """Return the piston with the drag of blade and guide; ``viscosity`` of the liquid in Pa s."""
        if not self.has_parts:
            return self
        result, drag = copy.copy(self), 0.0
        if self.blade is not None:
            if viscosity is None:
                raise FieldError("requires a liquid in the cell; give effects.drag.liquid", "piston", "blade")
            drag += self.blade.drag_coefficient(cell.width, cell.separation, viscosity)
        if self.guide is not None:
            drag += self.guide.drag_coefficient(grains.liquid_temperature, viscosity)
        object.__setattr__(result, "drag", drag)
        return result

    def to_plain(self) -> dict[str, Any]:
        """Return plain data as `Section.to_plain` does, without the drag computed from blade and guide."""
        plain = super().to_plain()
        if self.has_parts:
            del plain["drag"]
        return plain


class Output(Section):
    """Output of a run: recorded time series, frames, and their intervals.

    Attributes
    ----------
    scalars : float
        Time between records of piston, wall forces and energies [s].
    frames : float
        Time between frames [s]; a frame contains the grains' positions, velocities and forces.
    record : str or None
        Stage whose piston motion is used for identification; the whole run if not given.
    """

    scalars: float = quantity("s", default=0.001, above=0.0)
    frames: float = quantity("s", default=0.1, above=0.0)
    record: str | None = text_field(default=None, optional=True)

    @property
    def records_per_frame(self) -> int:
        """Number of records per frame."""
        return round(self.frames / self.scalars)

    def validate(self) -> None:
        """Check that the frame interval is an integer multiple of the record interval."""
        ratio = self.frames / self.scalars
        if ratio < 0.5 or abs(ratio - round(ratio)) > 1e-6 * ratio:
            near = max(1, round(ratio)) * self.scalars
            raise FieldError(
                f"{self.frames:g} s is not a multiple of output.scalars = {self.scalars:g} s; use {near:g}",
                "frames",
            )
