"""Constants of a run, in natural units, as the compiled loop takes them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from granular.compiled import Array, compiled
from granular.pairs.disc_law_tables import STIFFNESS, DiscLaw
from granular.pairs.grain_arrays import value_or_one
from granular.pairs.mesh_far_field import FarFieldSettings
from granular.pairs.stripes import CutOffSettings
from granular.pairs.verlet_list import VerletSettings

if TYPE_CHECKING:
    from jaxtyping import Float


class EffectLaws(NamedTuple):
    """The effects that act; what does not is None, or no law, and compiled away."""

    laws: tuple[Any, ...]
    host: Any
    dipole: bool | None
    walls: tuple[Any, ...]
    weight: Float[Array, "m"] | None
    cut: CutOffSettings | None
    listing: VerletSettings | None
    far: FarFieldSettings | None
    nearest: Float[Array, "3"] | None  # [D]
    discs: DiscLaw | None = None
    series: Array | None = None
    shift: Array | None = None

    @property
    def periods(self) -> tuple[float, float] | None:
        """Sides of a periodic cell [D]."""
        if self.nearest is not None:
            return float(self.nearest[0]), float(self.nearest[1])
        return None if self.cut is None else self.cut.periods


class PistonResistance(NamedTuple):
    """Resistance to the motion of a free piston."""

    rate: float  # [1/tau]
    force: float  # [F*]


class Constants(NamedTuple):
    """Constants of a run (but that grains may leave)."""

    grains: int
    masses: Float[Array, "m"] | None
    moments: Float[Array, "m"] | None
    least_mass: float
    least_moment: float
    least_ratio: float
    width: float  # [D]
    piston_mass: float  # [m]
    piston_weight: float  # [F*]
    resistance: PistonResistance | None
    exit: float  # [D]
    acting: EffectLaws
    threaded: bool | None


@compiled(inline=True)
def relative_moments(constants: Constants) -> Float[Array, "m"] | None:
    """Magnetic moment of each grain over that of the first species; None where all are alike."""
    return _values_or_default(constants.moments, constants.masses)


@compiled(inline=True)
def pair_stiffness_bound(discs: DiscLaw | None) -> float:
    """Bound of a pair's stiffness over 3 / rho^5, with rho its distance [D]."""
    return 1.0 if discs is None else discs.coefficients[STIFFNESS]


@compiled(inline=True)
def _values_or_default(values: Array | None, otherwise: Array | None) -> Array | None:
    return otherwise if values is None else values


@compiled
def multiply_by_moment_over_mass(
    stiffness: Float[Array, "m"],
    moments: Float[Array, "m"] | None,
    masses: Float[Array, "m"] | None,
    count: int,
) -> None:
    """Turn stiffnesses of grains of moment 1 into those of the grains over their masses.

    stiffness [F*/D, 1/tau^2].
    """
    if moments is not None:
        for i in range(count):
            stiffness[i] *= moments[i] / value_or_one(masses, i)
