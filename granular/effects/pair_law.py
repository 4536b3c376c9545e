"""Pair laws defined by their energy, in addition to dipole forces or without them.

A pair law gives the energy of two grains at a distance, for each pair of species; the force is the derivative
of its table (`granular.pairs.piecewise`). A law that decreases as 1/r^3 also has the coefficient of this
tail, which is summed over all pairs like dipole forces: by direct sum, cut-off or mesh. The tails of all laws
and the dipole forces are computed as one sum, so the total coefficient of a pair must be a product of one
number per grain. If moments are scattered (``grains.spread``), the energy of a pair must either be
proportional to both moments or not depend on the moments.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Hashable, Sequence
from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.effects.effect import EffectContext, ForceEffect
from granular.kernel_data.state import Bed, Constants
from granular.pairs.dipole_law import ENERGY
from granular.pairs.direct_sum import pad_values
from granular.pairs.near_law import (
    END,
    TAIL,
    NearLaw,
    NearTables,
    SeriesTerms,
    add_near_forces,
    allocate_near_list_of_law,
    collision_frequency_table,
    join_collision_frequency_tables,
    make_near_law,
    near_energy_and_add_stiffness,
    species_pairs_and_indices,
    squared_collision_frequency,
)
from granular.pairs.near_list import NearList
from granular.pairs.piecewise import Sampled, Samples, tabulate_energies
from granular.shared.array_types import Float, Int
from granular.shared.errors import InputError

NEAREST, FARTHEST = 2.0**-6, 2.0**20
"""Range of distances [D] in which a law is tabulated; the first polynomial extends to smaller distances."""

_TABLE_ERROR = 2e-14
"""Relative error of the tabulated energy; for a smooth law the relative error of the force is below 1e-10."""

_NEGLIGIBLE = 1e-15
"""Fraction of the maximum energy at r > 1 D below which the energy of a law without ``reach`` counts as 0."""

_NEGLIGIBLE_WITH_TAIL = 1e-12
"""Fraction that replaces `_NEGLIGIBLE` for a law with a tail. It is larger, since a term in a higher power of
1/r could otherwise extend over hundreds of diameters."""

_EQUALITY_TOLERANCE = 1e-9
"""Maximum relative difference between numbers that count as equal."""


class Species(NamedTuple):
    """Species as passed to a pair law's functions; mass and moment relative to the first species."""

    mass: float
    moment: float
    diameter: float


@dataclasses.dataclass(frozen=True)
class PairFunctions:
    """Functions of a pair law, in natural units; laws with equal keys are equal."""

    key: Hashable
    reach: float  # cut-off distance [D]; infinite if not given
    name: str = dataclasses.field(compare=False)  # in messages
    energy: Callable[[float, Species, Species], float] = dataclasses.field(compare=False)
    tail: Callable[[Species, Species], float] | None = dataclasses.field(compare=False)  # of 1/r^3 [F* D^4]


class PairLaw(NamedTuple):
    """A pair law for the kernels; all pair laws share the same code."""

    factor: Float[np.ndarray, "m"] | None  # as in ``near``; repeated here as an array with a value per grain
    species: Int[np.ndarray, "m"] | None
    near: NearLaw

    def workspace(self, size: int, count: int) -> NearList | None:
        """Make the list of pairs within reach or close to it."""
        return allocate_near_list_of_law(self.near, count)

    @staticmethod
    @compiled
    def add_forces(law: PairLaw, near: NearList | None, index: int, bed: Bed, time: float) -> int:
        """Add the pair forces [F*]; time [tau]."""
        state, grains = bed.state, bed.constants.grains
        return add_near_forces(law.near, near, grains, state.x, state.y, state.fx, state.fy)

    @staticmethod
    @compiled
    def measure_energy_and_stiffness(
        law: PairLaw,
        near: NearList | None,
        index: int,
        bed: Bed,
        time: float,
        stiffness: Float[Array, "m"],
        energies: Float[Array, "laws"],
    ) -> int:
        """Store the energy of the pairs [F* D]; add their stiffness per mass [1/tau^2]."""
        state, constants = bed.state, bed.constants
        energies[index] = near_energy_and_add_stiffness(
            law.near, near, constants.grains, state.x, state.y, constants.masses, stiffness
        )
        return 0

    @staticmethod
    @compiled
    def squared_head_on_impact_frequency(
        law: PairLaw, workspace: None, index: int, speed: float, constants: Constants
    ) -> float:
        """Squared maximum angular frequency in a head-on impact of two grains [1/tau^2]; speed [D/tau]."""
        return squared_collision_frequency(law.near, speed)


class PairLawEffect(ForceEffect):
    """Base class of pair-law effects."""

    rank = 1
    periodic = True

    def pair_functions(self, context: EffectContext) -> PairFunctions:
        """Return the functions of the law, in natural units."""
        raise NotImplementedError

    def make_kernel_law(self, context: EffectContext) -> PairLaw:
        """Make the law for the compiled loop, in natural units."""
        functions = self.pair_functions(context)
        if functions.tail is not None and context.cut_off is not None:
            functions = dataclasses.replace(functions, reach=min(functions.reach, context.cut_off))
        return _make_pair_law(functions, context)

    def dipole_tail_coefficients(self, context: EffectContext) -> Float[np.ndarray, "k k"] | None:
        """Coefficient of 1/r^3 for each pair of species, relative to two dipoles of the first species."""
        functions, species = self.pair_functions(context), species_of_scene(context)
        if functions.tail is None:
            return None
        return np.array([[functions.tail(a, b) / ENERGY for b in species] for a in species])


def species_of_scene(context: EffectContext) -> list[Species]:
    """Species of a scene, in natural units."""
    grains = context.grains
    diameters = [kind.diameter / context.scales.length for kind in grains.species]
    numbers = zip(grains.mass_ratios(), grains.moment_ratios(), diameters, strict=True)
    return [Species(float(mass), float(moment), diameter) for mass, moment, diameter in numbers]


def tail_charges_of_grains(
    tails: Sequence[np.ndarray], context: EffectContext, *, dipoles: bool
) -> Float[np.ndarray, "n"] | None:
    """Return charges whose products are the total 1/r^3 coefficients of the pairs; None without tails."""
    if not tails:
        return None
    if dipoles and context.grains.magnets != "dipoles":
        raise InputError(
            "a pair law with a tail cannot be combined with the forces of discs (grains.magnets = "
            "'cylinders'); use 'dipoles', remove effects.dipole, or give a reach and no tail"
        )
    moments = context.grains.moment_ratios()
    total = np.sum(tails, axis=0) + (np.outer(moments, moments) if dipoles else 0.0)
    charges = np.sqrt(np.maximum(np.diag(total), 0.0))
    products = np.outer(charges, charges)
    if not (charges > 0.0).all() or not np.allclose(total, products, rtol=_EQUALITY_TOLERANCE, atol=0.0):
        raise InputError(
            "the coefficients of 1/r^3, tails plus dipoles, are not products of one positive number per "
            "species; write tails as c*q1*q2, remove effects.dipole, or give a reach and no tail"
        )
    return np.asarray(charges[context.species] * context.grains.moment_spread_factors())


def _make_pair_law(functions: PairFunctions, context: EffectContext) -> PairLaw:
    species = species_of_scene(context)
    tables = _tabulate_near_energies(functions, tuple(species), "dipole" in context.effects)
    periods = context.periods
    if periods is not None and np.isinf(tables.pairs[:, END]).any():
        raise InputError(
            f"{functions.name} does not vanish within {1e-3 * FARTHEST:.0f} diameters, as a periodic cell "
            "requires; give it a reach, or a tail if it decreases as 1/r^3"
        )
    factor = _energy_factors_of_moment_scatter(functions, species, context)
    if context.grains.spread > 0.0 and factor is None and tables.pairs[:, TAIL].any():
        raise InputError(
            f"{functions.name}: the tail is proportional to the scattered moments (grains.spread), but the "
            "energy is not; make the energy proportional to q1*q2, or give no tail"
        )
    diameters = [kind.diameter for kind in species]
    near = make_near_law(tables, diameters, context.species, factor, 1.0, periods)
    return PairLaw(factor, near.species, near)


# A table needs tens of thousands of calls; a study uses the same law again and again.
@functools.lru_cache(maxsize=32)
def _tabulate_near_energies(
    functions: PairFunctions, species: tuple[Species, ...], dipoles: bool
) -> NearTables:
    indices, rows = species_pairs_and_indices(len(species))
    pairs = [(species[i], species[j]) for i, j in indices]
    _check_energy_symmetric_in_grains(functions, pairs)
    tails = [0.0 if functions.tail is None else functions.tail(*pair) for pair in pairs]
    energies = [
        _make_near_energy_function(functions, *pair, tail) for pair, tail in zip(pairs, tails, strict=True)
    ]
    negligible = _NEGLIGIBLE_WITH_TAIL if any(tails) else _NEGLIGIBLE
    reach = min(functions.reach, max(_negligible_energy_distance(energy, negligible) for energy in energies))
    _check_energy_finite(functions, pairs, reach)
    end, sampled = (
        min(reach, FARTHEST),
        [_make_truncated_energy_function(energy, reach) for energy in energies],
    )
    return NearTables(
        energies=tabulate_energies(sampled, NEAREST**2, 1.05 * end**2, _TABLE_ERROR, rows),
        pairs=np.array([[tail / ENERGY, 0.0, 0.0, reach**2] for tail in tails])[rows],
        series=SeriesTerms(),
        collisions=join_collision_frequency_tables(
            [_collision_frequency_table(functions, kind, end, dipoles) for kind in species]
        ),
    )


def _evaluate_pair_energies(functions: PairFunctions, first: Species, second: Species, r: Samples) -> Samples:
    """Energies at distances (n,); NaN if the function fails."""
    result = np.full(len(r), np.nan)
    for k, distance in enumerate(r.tolist()):
        try:
            result[k] = functions.energy(distance, first, second)
        except (ArithmeticError, ValueError):
            continue
    return result


def _make_near_energy_function(
    functions: PairFunctions, first: Species, second: Species, tail: float
) -> Sampled:
    """Make a function of distances (n,) that returns energy minus tail of a pair, and |energy| + |tail|."""

    def energy_minus_tail_and_magnitude(r: Samples) -> tuple[Samples, Samples]:
        total, part = _evaluate_pair_energies(functions, first, second, r), tail / r**3
        return total - part, np.abs(total) + np.abs(part)

    return energy_minus_tail_and_magnitude


def _negligible_energy_distance(energy: Sampled, negligible: float) -> float:
    """Distance [D] beyond which an energy is negligible; distances above `FARTHEST`/1000 become infinite."""
    r = np.geomspace(1.0, 1e-3 * FARTHEST, 400)
    value, magnitude = energy(r)
    size = np.abs(value)
    # The rounding error of the difference is negligible, too.
    rounding = 8.0 * np.finfo(np.float64).eps * magnitude
    relevant = size > np.maximum(negligible * np.nanmax(size), rounding)
    last = int(np.flatnonzero(relevant).max(initial=0))
    return math.inf if last == len(r) - 1 else float(r[last + 1])


def _make_truncated_energy_function(energy: Sampled, reach: float) -> Sampled:
    """Make a function of squared distances (n,): the energy, shifted to 0 at the reach, and 0 beyond."""
    shift = float(energy(np.array([reach]))[0][0]) if math.isfinite(reach) else 0.0

    def shifted_energy_and_magnitude(u: Samples) -> tuple[Samples, Samples]:
        inside = u < reach * reach
        value, magnitude = energy(np.sqrt(np.where(inside, u, 1.0)))
        return np.where(inside, value - shift, 0.0), magnitude + abs(shift)

    return shifted_energy_and_magnitude


def _collision_frequency_table(
    functions: PairFunctions, kind: Species, end: float, dipoles: bool
) -> Float[np.ndarray, "2 n"]:
    r = np.geomspace(NEAREST, min(end, 40.0), 400)
    energy = np.nan_to_num(_evaluate_pair_energies(functions, kind, kind, r))
    # Dipoles reverse the grains before such a law does.
    return collision_frequency_table(r, energy + dipoles * ENERGY * kind.moment**2 / r**3, kind.mass)


_TRIALS = np.geomspace(0.05, 50.0, 120)
"""Distances [D] at which a law is tested; a law that is 0 at all these distances counts as 0."""


def _check_energy_symmetric_in_grains(
    functions: PairFunctions, pairs: Sequence[tuple[Species, Species]]
) -> None:
    """Check that the energy does not change if the two grains are exchanged."""
    for first, second in pairs:
        orders = (first, second), (second, first)
        given, exchanged = (_evaluate_pair_energies(functions, *pair, _TRIALS) for pair in orders)
        wrong = ~np.isclose(given, exchanged, rtol=_EQUALITY_TOLERANCE, atol=0.0, equal_nan=True)
        if wrong.any():
            raise InputError(
                f"{functions.name}: the energy is {given[wrong][0]:.6g} and, with the grains exchanged, "
                f"{exchanged[wrong][0]:.6g}; use an energy that is symmetric in the two grains"
            )


def _check_energy_finite(
    functions: PairFunctions, pairs: Sequence[tuple[Species, Species]], reach: float
) -> None:
    """Check that the energy is a finite number from half the contact distance to the reach."""
    for first, second in pairs:
        contact = 0.5 * (first.diameter + second.diameter)
        r = np.geomspace(0.5 * contact, min(max(reach * (1.0 - 1e-12), contact), 100.0), 300)
        invalid = r[~np.isfinite(_evaluate_pair_energies(functions, first, second, r))]
        if len(invalid):
            raise InputError(
                f"{functions.name}: the energy is not a number at {invalid[0]:.4g} diameters; give a smaller "
                "reach, or correct the energy"
            )


def _energy_factors_of_moment_scatter(
    functions: PairFunctions, species: Sequence[Species], context: EffectContext
) -> Float[np.ndarray, "m"] | None:
    """Factor of each grain in the energy due to scattered moments; None if all factors are 1."""
    if context.grains.spread == 0.0:
        return None
    ratios = np.zeros(0)
    for first, second in itertools.combinations_with_replacement(species, 2):
        stronger = first._replace(moment=1.25 * first.moment), second._replace(moment=1.5 * second.moment)
        before, after = (
            _evaluate_pair_energies(functions, *pair, _TRIALS) for pair in ((first, second), stronger)
        )
        valid = np.isfinite(before) & np.isfinite(after) & (np.abs(before) > np.finfo(np.float64).tiny)
        ratios = np.append(ratios, after[valid] / before[valid])
    if np.allclose(ratios, 1.0, rtol=_EQUALITY_TOLERANCE):
        return None
    if np.allclose(ratios, 1.25 * 1.5, rtol=_EQUALITY_TOLERANCE):
        return pad_values(context.grains.moment_spread_factors())
    raise InputError(
        f"{functions.name} cannot be tabulated for scattered moments (grains.spread), because it is neither "
        "proportional to q1*q2 nor independent of the moments; write it as q1*q2 times a function of r, or "
        "use species instead of spread"
    )
