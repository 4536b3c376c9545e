"""Constants of a run, in natural units, as the compiled loop takes them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from granular.compiled import Array, compiled
from granular.pairs.far_field import FarFieldSettings
from granular.pairs.grain_arrays import STIFFNESS, value_or_one
from granular.pairs.near_law import NearLaw
from granular.pairs.near_list import VerletSettings
from granular.pairs.stripes import CutOffSettings

if TYPE_CHECKING:
    from jaxtyping import Float


class EffectLaws(NamedTuple):
    """The effects that act; what does not is None, or no law, and compiled away."""

    laws: tuple[Any, ...]  # one for each effect but the dipole, in loop order
    host: Any  # the one of bodies besides the piston, and of springs
    dipole: bool | None  # sum over all pairs: of dipoles, discs, or the tails of own laws
    sides: tuple[Any, ...]  # of the cell, with their laws: see `granular.effects.wall_side`
    weight: Float[Array, "m"] | None  # where friction bears: weight_j of the sums over 1/r^3
    cut: CutOffSettings | None  # where pairs end; None, as the next: all pairs
    listing: VerletSettings | None  # de Paula's list
    far: FarFieldSettings | None  # far field beyond the radius where pairs end smoothly
    nearest: Float[Array, "3"] | None  # of a periodic direct sum: sides, and the radius [D]
    charges: Float[Array, "m"] | None = None  # in that sum: moments, where no own law has a tail; None: 1
    series: Float[Array, "8"] | None = None  # of discs: see `granular.pairs.grain_arrays.COMMON`
    shift: Float[Array, "m"] | None = None  # of unlike discs: part of each grain in b [D^2]
    near: NearLaw | None = None  # of discs: what close pairs have beyond that sum

    @property
    def periods(self) -> tuple[float, float] | None:
        """Sides of a periodic cell [D]."""
        if self.nearest is not None:
            return float(self.nearest[0]), float(self.nearest[1])
        return None if self.cut is None else self.cut.periods


class BodyResistance(NamedTuple):
    """Resistance of its guide to the motion of a body."""

    rate: float  # decay rate of the velocity [1/tau]
    force: float  # Coulomb friction [F*]


class Constants(NamedTuple):
    """Constants of a run (but that grains may leave)."""

    grains: int  # number of grains
    masses: Float[Array, "m"] | None  # over the first species'; None: all alike, moments too
    # A second array in here made a step of 92 grains 10 % slower. Kernels ask `relative_moments`.
    moments: Float[Array, "m"] | None  # likewise; None: same numbers as the masses
    least_mass: float  # of the grain that others come closest to
    least_moment: float  # likewise
    least_ratio: float  # least moment over mass
    piston_mass: float  # [m]; inf: none is given
    piston_weight: float  # [F*]
    resistance: BodyResistance | None
    exit: float  # height below which a grain has left [D]; -inf: no gap
    acting: EffectLaws
    threaded: bool | None  # None: one thread


@compiled(inline=True)
def relative_moments(constants: Constants) -> Float[Array, "m"] | None:
    """Magnetic moment of each grain over that of the first species; None where all are alike."""
    return _values_or_default(constants.moments, constants.masses)


@compiled(inline=True)
def pair_stiffness_bound(series: Float[Array, "8"] | None) -> float:
    """Bound of a pair's stiffness over 3 / rho^5, with rho its distance [D]."""
    return 1.0 if series is None else series[STIFFNESS]


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
    """Turn stiffness of grains of moment 1 [F*/D] into that of the grains over mass [1/tau^2]."""
    if moments is not None:
        for i in range(count):
            stiffness[i] *= moments[i] / value_or_one(masses, i)
