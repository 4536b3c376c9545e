"""Constants of a run, in natural units, as the compiled loop takes them."""

from __future__ import annotations

from typing import Any, NamedTuple

from granular.compiled import Array, compiled
from granular.pairs.disc_law_tables import STIFFNESS, DiscLaw
from granular.pairs.grain_arrays import value_or_one
from granular.pairs.mesh_far_field import FarFieldSettings
from granular.pairs.stripes import CutOffSettings
from granular.pairs.verlet_list import VerletSettings


class EffectLaws(NamedTuple):
    """The effects that act; what does not is None, or no law, and compiled away.

    Attributes
    ----------
    laws : tuple
        A named tuple for each effect that acts but for the dipole, in the order in which the loop
        takes them; see `granular.effects.effect`.
    host : HostLaw or None
        The one among them that carries the cell, and moves all the others.
    dipole : bool or None
    walls : tuple
        Law of each wall, in the order of `granular.effects.wall_side.SIDES`; None: it is open.
        (No named tuple: kernels take each law out as a whole.)
    weight : float64 (m,) or None
        Where friction bears on the grains: weight_j of the sums over weight_j / r_ij^3 that the
        pass over the pairs takes along.
    cut : CutOffSettings or None
        Where pairs end; with None for this and the next, all pairs are summed.
    listing : VerletSettings or None
        Parameters of de Paula's Verlet list.
    far : FarFieldSettings or None
        Far field beyond the radius where pairs end smoothly.
    nearest : float64 (3,) or None
        Of the direct sum in a periodic cell: its sides, and the radius where pairs end [D].
    discs : DiscLaw or None
        Law of discs, which stands for that of dipoles.
    series, shift : float64 arrays or None
        Of ``discs``.
    """

    laws: tuple[Any, ...]
    host: Any
    dipole: bool | None
    walls: tuple[Any, ...]
    weight: Array | None
    cut: CutOffSettings | None
    listing: VerletSettings | None
    far: FarFieldSettings | None
    nearest: Array | None
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
    """Resistance to the motion of a free piston.

    Attributes
    ----------
    rate : float
        Decay rate of its velocity [1/tau].
    force : float
        Coulomb friction [F*].
    """

    rate: float
    force: float


class Constants(NamedTuple):
    """Constants of a run (but that grains may leave).

    Attributes
    ----------
    grains : int
        Number of grains.
    masses : float64 (m,) or None
        Mass of each grain over that of the first species; None where all grains are alike, in
        their moments, too.
    moments : float64 (m,) or None
        Magnetic moment of each grain over that of the first species. None where these are the same
        numbers as the masses, as in species of one material and thickness: a second array in here
        makes a step of 92 grains 10 % slower. Kernels ask `relative_moments`.
    least_mass, least_moment : float
        Mass and moment of the grain that others come closest to: the lightest, where all are of the
        same material.
    least_ratio : float
        Least moment over mass; 1 where all are of one material and thickness.
    width : float
        Cell width [D].
    piston_mass, piston_weight : float
        [m], [F*]; the mass is infinite where none is given.
    resistance : PistonResistance or None
        Resistance to the motion of the piston.
    exit : float
        Height below which a grain has left through a gap [D]; minus infinity where there is none.
    acting : EffectLaws
    threaded : bool or None
        None for one thread.
    """

    grains: int
    masses: Array | None
    moments: Array | None
    least_mass: float
    least_moment: float
    least_ratio: float
    width: float
    piston_mass: float
    piston_weight: float
    resistance: PistonResistance | None
    exit: float
    acting: EffectLaws
    threaded: bool | None


@compiled(inline=True)
def relative_moments(constants: Constants) -> Array | None:
    """Magnetic moment of each grain over that of the first species; None where all are alike.

    Parameters
    ----------
    constants : Constants
        Constants of the run.

    Returns
    -------
    float64 (m,) or None
        Without unit; None where all are 1.
    """
    return _values_or_default(constants.moments, constants.masses)


@compiled(inline=True)
def pair_stiffness_bound(discs: DiscLaw | None) -> float:
    """Bound of a pair's stiffness over 3 / rho^5, with rho its distance [D].

    Parameters
    ----------
    discs : DiscLaw or None
        Law of discs; None of dipoles.

    Returns
    -------
    float
        Without unit; 1 for dipoles.
    """
    return 1.0 if discs is None else discs.coefficients[STIFFNESS]


@compiled(inline=True)
def _values_or_default(values: Array | None, otherwise: Array | None) -> Array | None:
    return otherwise if values is None else values


@compiled
def multiply_by_moment_over_mass(
    stiffness: Array, moments: Array | None, masses: Array | None, count: int
) -> None:
    """Turn stiffnesses of grains of moment 1 into those of the grains over their masses.

    Parameters
    ----------
    stiffness : float64 (m,)
        Stiffness [F*/D]; becomes [1/tau^2].
    moments : float64 (m,) or None
        Moments over that of the first species; None where they are the masses.
    masses : float64 (m,) or None
        Masses over that of the first species; None where all are 1.
    count : int
        Number of grains.
    """
    if moments is not None:
        for i in range(count):
            stiffness[i] *= moments[i] / value_or_one(masses, i)
