"""Discs as kernels take them: a sum over all pairs, and the near part of the law.

All pairs are summed by (natural units, moments aside, rho^2 = r^2 - b)

    E = (1/4) (rho^-3 + c rho^-8),   F/r = (3/4) (rho^-5 + (8/3) c rho^-10),

the dipoles' law at another distance with one more term. With s = rho^-5 it is a completed square,

    s + (8/3) c s^2 = (8/3) c ((s + g)^2 - g^2),   g = 3/(16 c),

so that it costs no more than dipoles. With b the far field is exact up to the second multipole, and c is
what brings this law closest to that of `granular.pairs.disc_law` beyond a distance. Nearer pairs have the
difference added, `granular.pairs.near_law`. Below contact the force goes on with its value and slope.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.pairs.dipole_law import ENERGY
from granular.pairs.direct_sum import pad_values
from granular.pairs.disc_law import (
    Disc,
    Samples,
    contact_distance,
    contact_force_singularity,
    disc_energy_and_force,
    pair_squared_distance_shift,
    squared_distance_shift,
)
from granular.pairs.disc_torque import LOAD_FIFTH, disc_load, disc_load_law, fit_load_term
from granular.pairs.grain_arrays import FAR, LOAD_FAR, LOAD_TERM
from granular.pairs.near_law import (
    END,
    LEAST,
    NearLaw,
    NearTables,
    SeriesTerms,
    collision_stiffness,
    join_collisions,
    make_near_law,
    species_pairs,
)
from granular.pairs.piecewise import Sampled, tabulate_energies, tabulate_values
from granular.pairs.simd import DISC_SCALE
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float, Int

TOLERANCE, RELATIVE = 9e-7, 9e-6
"""Error of the law beyond the tables: of energy and force at contact, or of these themselves."""

CLOSEST = 0.98
"""Distance over that of contact at which a run stops."""

_TABLE_ERROR = 1e-12
"""Error of the tables over the energy: of the force, below 1e-8 of itself from contact on."""

_LOAD_ERROR = 1e-6
"""Error of the tables over the load."""

_WINDOW = 1.01
"""Last part of a table, over where the law is good enough, in which it goes to zero."""

_REACHES = np.arange(1.3, 8.01, 0.05)
"""Ends of the tables that are tried, over the greatest contact distance."""

_BEYOND = 40.0
"""Greatest distance looked at, over that of contact."""

_LEAST_TERM = 0.004
"""Lower bound of c: the square leaves rounding errors of 1e-17 / c of the force at D."""


class DiscSeries(NamedTuple):
    """The sum over all pairs of discs; see the head of this file."""

    coefficients: Float[np.ndarray, "8"]  # see `granular.pairs.grain_arrays.COMMON`
    shift: Float[np.ndarray, "m"] | None  # part of each grain in b [D^2]; None: all alike


class _ExactDiscPair(NamedTuple):
    """Two discs, and their exact law at distances from contact on; over that of dipoles."""

    discs: tuple[Disc, Disc]
    r: Samples
    energy: Samples
    force: Samples

    @property
    def shift(self) -> float:
        return pair_squared_distance_shift(*self.discs)

    def errors_over_tolerance(self, begin: float, c: float) -> Samples:
        """Errors of the sum over all pairs from a distance on, over what is allowed."""
        energy, force = _all_pairs_law(self.r, self.shift, c)
        chosen = self.r >= begin
        return np.concatenate(
            [
                ((law - exact) / np.maximum(TOLERANCE * exact[0], RELATIVE * exact))[chosen]
                for law, exact in ((energy, self.energy), (force, self.force))
            ]
        )


def _all_pairs_law(r: Samples, shift: float, c: float) -> tuple[Samples, Samples]:
    """Energy and force of the law of all pairs, over those scales of dipoles."""
    rho = np.sqrt(r * r - shift)
    return rho**-3 + c * rho**-8, r * (3.0 * rho**-5 + 8.0 * c * rho**-10)


def make_disc_laws(
    discs: Sequence[Disc],
    species: Int[np.ndarray, "n"],
    factor: Float[np.ndarray, "m"] | None = None,
    strength: float = 1.0,
    periods: tuple[float, float] | None = None,
    *,
    loads: bool = False,
) -> tuple[DiscSeries, NearLaw]:
    """Make both parts of the law of discs, in units of the first one's diameter; factor: the moments."""
    coefficients, tables = (_tabulate_with_loads if loads else _tabulate)(tuple(discs))
    shift = pad_values(np.array([squared_distance_shift(discs[k]) for k in species]))
    coefficients, mean = coefficients.copy(), float(shift[: len(species)].mean()) if len(species) else 0.0
    coefficients[FAR], coefficients[LOAD_FAR] = 3.0 * mean, LOAD_FIFTH * mean
    near = make_near_law(tables, [2.0 * disc.radius for disc in discs], species, factor, strength, periods)
    return DiscSeries(coefficients, None if len(discs) == 1 else shift), near


@functools.cache
def _tabulate(discs: tuple[Disc, ...]) -> tuple[Float[np.ndarray, "8"], NearTables]:
    """Coefficients and tables, which depend on the species alone."""
    indices, rows = species_pairs(len(discs))
    pairs = [_make_exact_pair(discs[i], discs[j]) for i, j in indices]
    c, centre = _complete_the_square(_fit_energy_coefficient(pairs))
    begins = [_law_validity_distance(pair, c) for pair in pairs]
    common = 2.0 * squared_distance_shift(discs[0]) if len(discs) == 1 else 0.0
    slope = max(_greatest_stiffness(pair, begin, c) for pair, begin in zip(pairs, begins, strict=True))
    low, high = 0.95 * CLOSEST * min(pair.r[0] for pair in pairs), _WINDOW * max(begins)
    sampled = [_sampled_near_energy(pair.discs, begin, c) for pair, begin in zip(pairs, begins, strict=True)]
    numbers = [
        [1.0, pair.shift, (CLOSEST * pair.r[0]) ** 2, (_WINDOW * begin) ** 2]
        for pair, begin in zip(pairs, begins, strict=True)
    ]
    tables = NearTables(
        energies=tabulate_energies(sampled, low**2, 1.05 * high**2, _TABLE_ERROR, rows),
        pairs=np.array(numbers)[rows],
        series=SeriesTerms(c, slope),
        collisions=join_collisions(
            [_collision_stiffness(pair) for pair in pairs if pair.discs[0] == pair.discs[1]]
        ),
    )
    return np.array([common, c, centre, 0.5 * DISC_SCALE / centre, 0.0, slope, 0.0, 0.0]), tables


def _collision_stiffness(pair: _ExactDiscPair) -> Samples:
    """Squared speeds and frequencies of head-on collisions of equal discs."""
    r = pair.r[0] * np.append(np.linspace(CLOSEST, 1.0, 20)[:-1], pair.r / pair.r[0])
    return collision_stiffness(r, ENERGY * disc_law_continued_below_contact(r, pair.discs)[0])


def _make_exact_pair(first: Disc, second: Disc) -> _ExactDiscPair:
    contact = contact_distance(first, second)
    r = np.geomspace(contact, _BEYOND * contact, 400)
    return _ExactDiscPair((first, second), r, *disc_energy_and_force(r, first, second))


def _fit_energy_coefficient(pairs: Sequence[_ExactDiscPair]) -> float:
    """Return the c that makes the law good enough from the least distance on."""
    longest = max(pair.r[0] for pair in pairs)
    for begin in _REACHES * longest:
        at_zero = np.concatenate([pair.errors_over_tolerance(begin, 0.0) for pair in pairs])
        slopes = np.concatenate([pair.errors_over_tolerance(begin, 1.0) for pair in pairs]) - at_zero
        # A few weighted least squares make the greatest error least (Lawson 1961).
        weights = np.ones(len(at_zero))
        for _ in range(30):
            c = -float(weights * slopes @ at_zero / (weights * slopes @ slopes))
            errors = np.abs(at_zero + c * slopes)
            if errors.max() <= 1.0 and abs(c) >= _LEAST_TERM:
                return c
            weights *= errors / errors.max()
    height = max(disc.height / (2.0 * disc.radius) for pair in pairs for disc in pair.discs)
    raise InputError(
        f"grains.magnets = 'cylinders': discs {height:.3g} times as high as wide differ from "
        f"dipoles beyond {_REACHES[-1]:g} diameters; take flatter ones, or 'dipoles'"
    )


def _complete_the_square(c: float) -> tuple[float, float]:
    """Return c, changed in its last digits, and g / `DISC_SCALE` whose square is exact: padding adds 0."""
    centre = float(np.float32(3.0 / (16.0 * c * DISC_SCALE)))
    return 3.0 / (16.0 * centre * DISC_SCALE), centre


def _law_validity_distance(pair: _ExactDiscPair, c: float) -> float:
    """Distance from which on the law with that c is good enough [D]."""
    wrong = np.abs(pair.errors_over_tolerance(0.0, c)).reshape(2, -1).max(axis=0) > 1.0
    return float(pair.r[np.flatnonzero(wrong).max(initial=0) + 1])


def _greatest_stiffness(pair: _ExactDiscPair, begin: float, c: float) -> float:
    """Greatest stiffness beyond a distance, over that of dipoles at rho."""
    r = pair.r[pair.r >= begin]
    u, rho = r * r, np.sqrt(r * r - pair.shift)
    slope = 15.0 * u * rho**-7 - 3.0 * rho**-5 + 8.0 * c * (10.0 * u * rho**-12 - rho**-10)
    return float((np.abs(slope) / (12.0 * rho**-5)).max())


@functools.cache
def _tabulate_with_loads(discs: tuple[Disc, ...]) -> tuple[Float[np.ndarray, "8"], NearTables]:
    """Coefficients and tables, with those of the load on the plates."""
    (coefficients, tables), pairs = _tabulate(discs), list(itertools.product(discs, discs))
    c, ends = tables.series.term, np.sqrt(tables.pairs[:, END])
    coefficients, term = coefficients.copy(), fit_load_term(pairs, ends, c)
    coefficients[LOAD_TERM] = term
    sampled = [_sampled_near_load(pair, end, c, term) for pair, end in zip(pairs, ends, strict=True)]
    low, high = tables.pairs[:, LEAST].min(), 1.05 * tables.pairs[:, END].max()
    return coefficients, tables._replace(loads=tabulate_values(sampled, low, high, _LOAD_ERROR))


def _sampled_near_load(discs: tuple[Disc, Disc], end: float, c: float, term: float) -> Sampled:
    """Value beside 1/r^3 in the load on the first disc, less that of the sum over all pairs."""

    def sampled(u: Samples) -> tuple[Samples, Samples]:
        r = np.sqrt(u)
        exact, t = disc_load(r, *discs), np.clip((end - r) / (end - end / _WINDOW), 0.0, 1.0)
        part = disc_load_law(r, *discs, c, term)
        return (exact - part) * t**3 * (10.0 - 15.0 * t + 6.0 * t * t), exact

    return sampled


_GAUSS, _WEIGHTS = np.polynomial.legendre.leggauss(12)
"""Nodes and weights on (-1, 1) for the energy of the last part of a table."""


def _sampled_near_energy(discs: tuple[Disc, Disc], begin: float, c: float) -> Sampled:
    """Energy of two discs less that of the sum over all pairs; its force goes smoothly to zero."""
    shift, end = pair_squared_distance_shift(*discs), _WINDOW * begin

    def difference(r: Samples) -> tuple[Samples, Samples, Samples]:
        exact, part = disc_law_continued_below_contact(r, discs), _all_pairs_law(r, shift, c)
        return ENERGY * (exact[0] - part[0]), ENERGY * (exact[1] - part[1]), ENERGY * (exact[0] + part[0])

    def windowed(r: Samples) -> Samples:
        """Energy within the window: the integral of a force that ends there."""
        points = 0.5 * (end + r) + 0.5 * (end - r) * _GAUSS[:, None]
        t = np.clip((end - points) / (end - begin), 0.0, 1.0)
        force = difference(points.ravel())[1].reshape(points.shape) * t**3 * (10.0 - 15.0 * t + 6.0 * t * t)
        return np.asarray(0.5 * (end - r) * (_WEIGHTS @ force))

    constant = float((windowed(np.array([begin])) - difference(np.array([begin]))[0])[0])

    def sampled(u: Samples) -> tuple[Samples, Samples]:
        # Tables of all species begin at their smallest contact, where rho^2 of larger discs is below zero.
        r = np.clip(np.sqrt(u), 0.9 * CLOSEST * contact_distance(*discs), end)
        energy, _, magnitude = difference(r)
        last = r > begin
        energy = energy + constant
        energy[last] = windowed(r[last])
        return energy, magnitude

    return sampled


def disc_over_dipole_stiffness(r: Samples, discs: tuple[Disc, Disc]) -> Samples:
    """Stiffness of two discs over dipoles' at the same distance (n,); r (n,) [D]."""
    grid = contact_distance(*discs) * np.geomspace(CLOSEST, _BEYOND, 300)
    slopes = np.gradient(disc_law_continued_below_contact(grid, discs)[1], grid)
    return np.asarray(np.interp(r, grid, np.abs(slopes) * grid**5 / 12.0))


def disc_law_continued_below_contact(r: Samples, discs: tuple[Disc, Disc]) -> tuple[Samples, Samples]:
    """Energy and force (n,) of two discs, the force continued below contact as its tangent; r (n,) [D]."""
    contact = contact_distance(*discs)
    energy, force = disc_energy_and_force(np.maximum(r, contact), *discs)
    below, slope = np.minimum(r - contact, 0.0), force_slope_at_contact(*discs)
    return energy - below * (force + 0.5 * slope * below), force + slope * below


def force_slope_at_contact(first: Disc, second: Disc) -> float:
    """Slope dF/dr of the repulsion of two discs where they touch."""
    contact = contact_distance(first, second)
    factor, z = contact_force_singularity(first, second)
    step = 1e-4 * contact
    x: Samples = step * np.arange(3.0)
    force = disc_energy_and_force(contact + x, first, second)[1]
    # The singular part, whose second derivative is infinite, would spoil the difference quotient.
    smooth = force - factor * _real_part_of_power(x, z, 1.5)
    slope = (-1.5 * smooth[0] + 2.0 * smooth[1] - 0.5 * smooth[2]) / step
    return float(slope + 1.5 * factor * _real_part_of_power(np.array([0.0]), z, 0.5)[0])


def _real_part_of_power(x: Samples, z: float, exponent: float) -> Samples:
    return np.asarray(((x + 1j * z) ** exponent).real * ((x > 0.0) | (z > 0.0)))
