"""Discs as kernels take them: a law that serves all pairs, and tables for the close ones.

All pairs are summed by (natural units, moments aside, rho^2 = r^2 - b)

    E = (1/4) (rho^-3 + c rho^-8),   F/r = (3/4) (rho^-5 + (8/3) c rho^-10),

the dipoles' law at another distance with one more term. With s = rho^-5 it is a completed square,

    s + (8/3) c s^2 = (8/3) c ((s + g)^2 - g^2),   g = 3/(16 c),

so that it costs no more than dipoles. With b the far field is exact up to the second multipole, and c is
what brings this law closest to that of `granular.pairs.disc_law` beyond a distance. Nearer pairs have the
difference added, from a table of F/r in r^2 for each pair of species: cubic pieces, and the singular part
at contact. Its energy is the integral of the same pieces. Below contact the force goes on with its value
and slope.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.pairs.dipole_law import STRENGTH
from granular.pairs.disc_law import (
    Disc,
    Samples,
    contact_distance,
    contact_force_singularity,
    disc_energy_and_force,
    pair_squared_distance_shift,
    squared_distance_shift,
)
from granular.pairs.simd import DISC_SCALE
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float, Int

TOLERANCE, RELATIVE = 9e-7, 9e-6
"""Error of the law beyond the tables: of energy and force at contact, or of these themselves."""

CLOSEST = 0.98
"""Distance over that of contact at which a run stops."""

_PIECE = 0.016
"""Width of a piece in r^2, over the square of the contact distance; errors are below 1e-7."""

_SINGULAR_PIECES = 20
"""Pieces, from contact on, that do without the singular part: up to 1.15 of the distance."""

_WINDOW = 1.01
"""Last part of a table, over where the law is good enough, in which it goes to zero."""

_REACHES = np.arange(1.3, 8.01, 0.05)
"""Ends of the tables that are tried, over the greatest contact distance."""

_BEYOND = 40.0
"""Greatest distance looked at, over that of contact."""

_LEAST_TERM = 0.004
"""Lower bound of c: the square leaves rounding errors of 1e-17 / c of the force at D."""

COMMON, TERM, CENTRE, FORCE_SCALE, FAR, STIFFNESS = range(6)
"""Coefficients of the law: b of all pairs (of alike discs); c; g / `DISC_SCALE`; what sums of forces lack
as a factor, besides `STRENGTH`; the factor of r^-5 that the far field has beside r^-3; the greatest
stiffness beyond the tables over that of dipoles at rho."""

START, PER_PIECE, CONTACT, HEIGHT, SINGULAR, LEAST, SMOOTH, END, SHIFT = range(9)
"""Entries of a pair of species: r^2 at which the table starts; pieces per D^2; r^2 at contact; z
over a length of r^2, and factor, of the singular part; r^2 at which a run stops, from which on the
pieces hold the singular part, and at which the table ends; b."""


class CloseDiscTables(NamedTuple):
    """Tables of the close pairs, for each pair of species."""

    pairs: Float[np.ndarray, "p 9"]  # see `START` and the others
    pieces: Float[np.ndarray, "p n 4"]  # F/r over the moments [F*/D]: powers of the part of a piece
    energies: Float[np.ndarray, "p n+1"]  # at the start of each piece, singular part aside [F* D]


TOUCH, SQUARES, STIFFNESSES = range(3)
"""Rows about two alike discs that meet head-on: the energy at contact in the first entry [F* D], over
the squared moment; squared speeds, rising, and the greatest squared angular frequency up to there,
both times the mass over the squared moment. The greatest over the species, and of energies the least."""


class DiscLaw(NamedTuple):
    """The grains as discs; see the head of this file."""

    coefficients: Float[np.ndarray, "6"]  # see `COMMON` and the others
    shift: Float[np.ndarray, "m"] | None  # part of each grain in b [D^2]; None where all are alike
    species: Int[np.ndarray, "m"] | None  # species of each grain; None: all alike
    kinds: int  # number of species
    reach: float  # distance at which the longest table ends [D]
    close: CloseDiscTables
    collision: Float[np.ndarray, "3 n"]  # see `TOUCH` and the others


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
        """Errors of the law of `DiscLaw` from a distance on, over what is allowed."""
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


def make_disc_law(discs: Sequence[Disc], species: Int[np.ndarray, "n"], size: int) -> DiscLaw:
    """Law and tables of some species of discs, in units of the first one's diameter."""
    made, alike, own = (
        _make_disc_law_of_species(tuple(discs)),
        len(discs) == 1,
        [squared_distance_shift(d) for d in discs],
    )
    coefficients = made.coefficients.copy()
    coefficients[FAR] = 3.0 * float(np.mean([own[k] for k in species])) if len(species) else 0.0
    shift, index = np.zeros(size), np.zeros(size, dtype=np.int64)
    shift[: len(species)], index[: len(species)] = [own[k] for k in species], species
    return made._replace(
        coefficients=coefficients, shift=None if alike else shift, species=None if alike else index
    )


@functools.cache
def _make_disc_law_of_species(discs: tuple[Disc, ...]) -> DiscLaw:
    """Law and tables, without what differs from grain to grain."""
    kinds = range(len(discs))
    pairs = {(i, j): _make_exact_pair(discs[i], discs[j]) for i in kinds for j in kinds if i <= j}
    c, centre = _complete_the_square(_fit_energy_coefficient(list(pairs.values())))
    begins = {key: _law_validity_distance(pair, c) for key, pair in pairs.items()}
    made = {key: _close_disc_table(pair.discs, begins[key], c) for key, pair in pairs.items()}
    tables = [made[min(i, j), max(i, j)] for i in kinds for j in kinds]
    # One piece of zeros behind each table: what is listed beyond it need not be left out.
    most = max(len(pieces) for _, pieces, _ in tables) + 1
    common = 2.0 * squared_distance_shift(discs[0]) if len(discs) == 1 else 0.0
    slope = max(_greatest_stiffness(pair, begins[key], c) for key, pair in pairs.items())
    return DiscLaw(
        coefficients=np.array([common, c, centre, 0.5 * DISC_SCALE / centre, 0.0, slope]),
        shift=None,
        species=None,
        kinds=len(discs),
        reach=_WINDOW * max(begins.values()),
        close=CloseDiscTables(
            np.array([numbers for numbers, _, _ in tables]),
            np.array([np.pad(p, ((0, most - len(p)), (0, 0))) for _, p, _ in tables]),
            np.array([np.pad(e, (0, most + 1 - len(e))) for _, _, e in tables]),
        ),
        collision=_collision_stiffness_table([pairs[k, k] for k in kinds]),
    )


def _collision_stiffness_table(pairs: Sequence[_ExactDiscPair]) -> Samples:
    """Entries of `DiscLaw.collision`, from pairs of alike discs; down to where a run stops."""
    rows = []
    for pair in pairs:
        r = np.append(pair.r[::-1], pair.r[0] * np.linspace(1.0, CLOSEST, 20)[1:])
        energy, force = disc_law_continued_below_contact(r, pair.discs)
        slopes = np.maximum.accumulate(np.abs(np.gradient(force, r)))
        rows.append((0.25 * energy, 0.5 * slopes))
    squares = np.unique(np.concatenate([energy for energy, _ in rows]))
    envelopes = [slopes[np.minimum(np.searchsorted(energy, squares), len(r) - 1)] for energy, slopes in rows]
    touch = min(0.25 * float(pair.energy[0]) for pair in pairs)
    return np.array([np.full(len(squares), touch), squares, np.max(envelopes, axis=0)])


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


def _smooth_cut_off_factor(u: Samples, begin: float, end: float) -> Samples:
    """1 up to r^2 = ``begin``, 0 from ``end`` on; twice differentiable."""
    t = np.clip((end - u) / (end - begin), 0.0, 1.0)
    return np.asarray(t**3 * (10.0 - 15.0 * t + 6.0 * t * t))


def _close_disc_table(
    discs: tuple[Disc, Disc], begin: float, c: float
) -> tuple[list[float], Samples, Samples]:
    """Entries of `CloseDiscTables` for two discs."""
    contact = contact_distance(*discs)
    touch, end = contact**2, (_WINDOW * begin) ** 2
    many = int(np.ceil((end - touch) / (_PIECE * touch)))
    width = (end - touch) / many
    below = int(np.ceil((1.0 - 0.95 * CLOSEST**2) * touch / width))
    nodes: Samples = touch + width / 3.0 * np.arange(-3.0 * below, 3.0 * many + 1.0)
    factor, z = contact_force_singularity(*discs)
    # x = r - contact is (r^2 - contact^2) / (2 contact) and what is smoother.
    factor, z = STRENGTH / 3.0 * factor / (contact * (2.0 * contact) ** 1.5), 2.0 * contact * z
    rest = _force_over_distance_difference(nodes, discs, c) * _smooth_cut_off_factor(nodes, begin**2, end)
    smooth = touch + _SINGULAR_PIECES * width
    singular = factor * _real_part_of_power(nodes - touch, z, 1.5)
    turned = np.linalg.inv(np.vander(np.arange(4) / 3.0, 4, increasing=True))
    indices = np.arange(below + many)[None] * 3 + np.arange(4)[:, None]
    pieces = (
        turned @ (rest[indices] - np.where(nodes[indices[:1]] < smooth - 0.5 * width, singular[indices], 0.0))
    ).T
    losses = 0.5 * width * (pieces @ (1.0 / np.arange(1.0, 5.0)))
    energies = np.append(np.cumsum(losses[::-1])[::-1], 0.0)
    energies[: below + _SINGULAR_PIECES] += (
        0.2 * factor * _real_part_of_power(np.array([smooth - touch]), z, 2.5)
    )
    numbers = [
        nodes[0],
        1.0 / width,
        touch,
        z,
        factor,
        (CLOSEST * contact) ** 2,
        smooth,
        end,
        pair_squared_distance_shift(*discs),
    ]
    return [float(number) for number in numbers], pieces, energies


def _real_part_of_power(x: Samples, z: float, exponent: float) -> Samples:
    return np.asarray(((x + 1j * z) ** exponent).real * ((x > 0.0) | (z > 0.0)))


def _force_over_distance_difference(u: Samples, discs: tuple[Disc, Disc], c: float) -> Samples:
    """F/r of the discs less that of the law of all pairs [F*/D]."""
    r = np.sqrt(u)
    _, force = disc_law_continued_below_contact(r, discs)
    return np.asarray(
        STRENGTH / 3.0 * (force - _all_pairs_law(r, pair_squared_distance_shift(*discs), c)[1]) / r
    )


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
