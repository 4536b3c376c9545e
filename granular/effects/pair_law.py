"""Laws of pairs of grains from their energy alone, beside or instead of the dipoles.

Such a law gives the energy of two grains at a distance, for each pair of species; the force is the
derivative of a table of it (`granular.pairs.piecewise`). A law that falls off as 1/r^3 gives its tail
besides, the coefficient, which is summed over all pairs as that of the dipoles is: by the direct sum, the
cut-off or the mesh. The tails of all laws and the dipoles are one sum, so they must be a product of one
number a grain. A scatter of the moments multiplies the energy if it is proportional to both moments, and
leaves it if it depends on neither.
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
    collision_stiffness,
    join_collisions,
    make_near_law,
    measure_near_part,
    near_law_workspace,
    species_pairs,
    squared_collision_frequency,
)
from granular.pairs.near_list import NearList
from granular.pairs.piecewise import Sampled, Samples, tabulate_energies
from granular.shared.array_types import Float, Int
from granular.shared.errors import InputError

NEAREST, FARTHEST = 2.0**-6, 2.0**20
"""Distances [D] between which a law is tabulated: below, it goes on as the last polynomial."""

_TABLE_ERROR = 2e-14
"""Error of a table over the energy: of the force below 1e-10 of itself, where the law is smooth."""

_NOTHING = 1e-15
"""Part of its energies beyond 1 D below which a law without a reach has ended."""

_NOTHING_BESIDE_TAIL = 1e-12
"""The same beside a tail: what falls off by a higher power would go on for hundreds of diameters."""

_PROPORTIONAL = 1e-9
"""Relative difference up to which numbers count as equal."""


class Species(NamedTuple):
    """A species as the functions of a pair law see it; over those of the first species."""

    mass: float
    moment: float
    diameter: float


@dataclasses.dataclass(frozen=True)
class PairFunctions:
    """A pair law as it was given, in natural units; of the same key, the same law."""

    key: Hashable
    reach: float  # infinite: none is given [D]
    name: str = dataclasses.field(compare=False)  # in messages
    energy: Callable[[float, Species, Species], float] = dataclasses.field(compare=False)
    tail: Callable[[Species, Species], float] | None = dataclasses.field(compare=False)  # of 1/r^3 [F* D^4]


class PairLaw(NamedTuple):
    """A pair law as the kernels take it: the same code for all of them."""

    factor: Float[np.ndarray, "m"] | None  # as in ``near``; arrays of the grains stand here, too
    species: Int[np.ndarray, "m"] | None
    near: NearLaw

    def workspace(self, size: int, count: int) -> NearList | None:
        """Make the near list of the grains within reach."""
        return near_law_workspace(self.near, count)

    @staticmethod
    @compiled
    def add_forces(law: PairLaw, near: NearList | None, index: int, bed: Bed, time: float) -> int:
        """Add the forces between the grains [F*]; time [tau]."""
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
        """Enter the energy of the pairs [F* D], and add their stiffness [1/tau^2]."""
        state, constants = bed.state, bed.constants
        energies[index] = measure_near_part(
            law.near, near, constants.grains, state.x, state.y, constants.masses, stiffness
        )
        return 0

    @staticmethod
    @compiled
    def squared_head_on_impact_frequency(
        law: PairLaw, workspace: None, index: int, speed: float, constants: Constants
    ) -> float:
        """Squared highest angular frequency as two grains meet head-on [1/tau^2]; speed [D/tau]."""
        return squared_collision_frequency(law.near, speed)


class PairLawEffect(ForceEffect):
    """Base of the effects that are pair laws."""

    rank = 1
    periodic = True

    def pair_functions(self, context: EffectContext) -> PairFunctions:
        """Return the law as it was given, in natural units."""
        raise NotImplementedError

    def make_kernel_law(self, context: EffectContext) -> PairLaw:
        """Law in natural units."""
        functions = self.pair_functions(context)
        if functions.tail is not None and context.cut_off is not None:
            functions = dataclasses.replace(functions, reach=min(functions.reach, context.cut_off))
        return _make_pair_law(functions, context)

    def tails(self, context: EffectContext) -> Float[np.ndarray, "k k"] | None:
        """Part of each pair of species in the sum over all pairs, over two dipoles' of the first."""
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


def grain_charges(
    tails: Sequence[np.ndarray], context: EffectContext, *, dipoles: bool
) -> Float[np.ndarray, "n"] | None:
    """Charge of each grain in the sum over all pairs, a product of which all tails are; None: its moment."""
    if not tails:
        return None
    if dipoles and context.grains.magnets != "dipoles":
        raise InputError(
            "a pair law with a tail cannot act beside grains.magnets = 'cylinders', which are summed by "
            "another law; take 'dipoles', leave effects.dipole out, or give a reach and no tail"
        )
    moments = context.grains.moment_ratios()
    total = np.sum(tails, axis=0) + (np.outer(moments, moments) if dipoles else 0.0)
    own = np.sqrt(np.maximum(np.diag(total), 0.0))
    if not (own > 0.0).all() or not np.allclose(total, np.outer(own, own), rtol=_PROPORTIONAL, atol=0.0):
        raise InputError(
            "the tails of the pair laws, with those of the dipoles, are no products of one positive number "
            "a species; give tails as c*q1*q2, leave effects.dipole out, or give a reach and no tail"
        )
    return np.asarray(own[context.species] * context.grains.moment_spread_factors())


def _make_pair_law(functions: PairFunctions, context: EffectContext) -> PairLaw:
    species = species_of_scene(context)
    tables = _tabulate(functions, tuple(species), "dipole" in context.effects)
    periods = context.periods
    if periods is not None and np.isinf(tables.pairs[:, END]).any():
        raise InputError(
            f"{functions.name} does not end within {1e-3 * FARTHEST:.0f} diameters: in a cell with periodic "
            "sides give it a reach, or a tail if it falls off as 1/r^3"
        )
    factor = _scatter_factors(functions, species, context)
    if context.grains.spread > 0.0 and factor is None and tables.pairs[:, TAIL].any():
        raise InputError(
            f"{functions.name}: moments that scatter (grains.spread) are charges of a tail; make the energy "
            "proportional to q1*q2, or take no tail"
        )
    diameters = [kind.diameter for kind in species]
    near = make_near_law(tables, diameters, context.species, factor, 1.0, periods)
    return PairLaw(factor, near.species, near)


# A law is tabulated by tens of thousands of calls; a study asks for the same one again and again.
@functools.lru_cache(maxsize=32)
def _tabulate(functions: PairFunctions, species: tuple[Species, ...], dipoles: bool) -> NearTables:
    indices, rows = species_pairs(len(species))
    pairs = [(species[i], species[j]) for i, j in indices]
    _check_symmetry(functions, pairs)
    tails = [0.0 if functions.tail is None else functions.tail(*pair) for pair in pairs]
    energies = [_near_energy(functions, *pair, tail) for pair, tail in zip(pairs, tails, strict=True)]
    nothing = _NOTHING_BESIDE_TAIL if any(tails) else _NOTHING
    reach = min(functions.reach, max(_decay_distance(energy, nothing) for energy in energies))
    _check_finite(functions, pairs, reach)
    end, sampled = min(reach, FARTHEST), [_truncate(energy, reach) for energy in energies]
    return NearTables(
        energies=tabulate_energies(sampled, NEAREST**2, 1.05 * end**2, _TABLE_ERROR, rows),
        pairs=np.array([[tail / ENERGY, 0.0, 0.0, reach**2] for tail in tails])[rows],
        series=SeriesTerms(),
        collisions=join_collisions([_collisions(functions, kind, end, dipoles) for kind in species]),
    )


def _evaluate(functions: PairFunctions, first: Species, second: Species, r: Samples) -> Samples:
    """Energies at distances (n,); not a number at those where the function fails."""
    result = np.full(len(r), np.nan)
    for k, distance in enumerate(r.tolist()):
        try:
            result[k] = functions.energy(distance, first, second)
        except (ArithmeticError, ValueError):
            continue
    return result


def _near_energy(functions: PairFunctions, first: Species, second: Species, tail: float) -> Sampled:
    """Energy of a pair without its tail, and the magnitudes of both, of distances (n,)."""

    def sampled(r: Samples) -> tuple[Samples, Samples]:
        total, part = _evaluate(functions, first, second, r), tail / r**3
        return total - part, np.abs(total) + np.abs(part)

    return sampled


def _decay_distance(energy: Sampled, nothing: float) -> float:
    """Distance at which an energy has ended by itself [D]; infinite if it does not by `FARTHEST`/1000."""
    r = np.geomspace(1.0, 1e-3 * FARTHEST, 400)
    value, magnitude = energy(r)
    size = np.abs(value)
    # What rounding leaves of a difference is nothing, too.
    there = size > np.maximum(nothing * np.nanmax(size), 8.0 * np.finfo(np.float64).eps * magnitude)
    last = int(np.flatnonzero(there).max(initial=0))
    return math.inf if last == len(r) - 1 else float(r[last + 1])


def _truncate(energy: Sampled, reach: float) -> Sampled:
    """Energy of squared distances (n,), less what it is at the reach and 0 from there on."""
    left = float(energy(np.array([reach]))[0][0]) if math.isfinite(reach) else 0.0

    def sampled(u: Samples) -> tuple[Samples, Samples]:
        inside = u < reach * reach
        value, magnitude = energy(np.sqrt(np.where(inside, u, 1.0)))
        return np.where(inside, value - left, 0.0), magnitude + abs(left)

    return sampled


def _collisions(
    functions: PairFunctions, kind: Species, end: float, dipoles: bool
) -> Float[np.ndarray, "2 n"]:
    r = np.geomspace(NEAREST, min(end, 40.0), 400)
    energy = np.nan_to_num(_evaluate(functions, kind, kind, r))
    # Dipoles turn grains before such a law does.
    return collision_stiffness(r, energy + dipoles * ENERGY * kind.moment**2 / r**3, kind.mass)


_TRIALS = np.geomspace(0.05, 50.0, 120)
"""Distances [D] at which a law is tried: a law that is nothing at all of them is nothing."""


def _check_symmetry(functions: PairFunctions, pairs: Sequence[tuple[Species, Species]]) -> None:
    """Check that both grains of a pair are treated alike."""
    for first, second in pairs:
        here, there = (_evaluate(functions, *pair, _TRIALS) for pair in ((first, second), (second, first)))
        wrong = ~np.isclose(here, there, rtol=_PROPORTIONAL, atol=0.0, equal_nan=True)
        if wrong.any():
            raise InputError(
                f"{functions.name}: the energy is {here[wrong][0]:.6g} and, with the grains exchanged, "
                f"{there[wrong][0]:.6g}; a pair must pull and push equally"
            )


def _check_finite(functions: PairFunctions, pairs: Sequence[tuple[Species, Species]], reach: float) -> None:
    """Check that the energy is a number from half the contact to the reach."""
    for first, second in pairs:
        contact = 0.5 * (first.diameter + second.diameter)
        r = np.geomspace(0.5 * contact, min(max(reach * (1.0 - 1e-12), contact), 100.0), 300)
        odd = r[~np.isfinite(_evaluate(functions, first, second, r))]
        if len(odd):
            raise InputError(
                f"{functions.name}: the energy is no number at {odd[0]:.4g} diameters; give it a reach below "
                "that, or correct it"
            )


def _scatter_factors(
    functions: PairFunctions, species: Sequence[Species], context: EffectContext
) -> Float[np.ndarray, "m"] | None:
    """Factor of each grain in the energy where the moments scatter; None: 1."""
    if context.grains.spread == 0.0:
        return None
    ratios = np.zeros(0)
    for first, second in itertools.combinations_with_replacement(species, 2):
        stronger = first._replace(moment=1.25 * first.moment), second._replace(moment=1.5 * second.moment)
        before, after = (_evaluate(functions, *pair, _TRIALS) for pair in ((first, second), stronger))
        there = np.isfinite(before) & np.isfinite(after) & (np.abs(before) > np.finfo(np.float64).tiny)
        ratios = np.append(ratios, after[there] / before[there])
    if np.allclose(ratios, 1.0, rtol=_PROPORTIONAL):
        return None
    if np.allclose(ratios, 1.25 * 1.5, rtol=_PROPORTIONAL):
        return pad_values(context.grains.moment_spread_factors())
    raise InputError(
        f"{functions.name} is neither proportional to both moments nor independent of them, so no table "
        "holds it for moments that scatter (grains.spread); write it as q1*q2 times a function of r, or take "
        "species"
    )
