"""The law of two uniformly magnetised discs whose axes are normal to the plates.

Each face bears the charge that its magnetisation ends on, so the energy is a sum over pairs of
faces, E = (mu0 M1 M2 / 4 pi) sum +-U(r, z), z the height of the one face above the other and

    U(r, z) = integral of 1/distance over both faces
            = integral over v of A(v) v 4 K(m) / a,   m = 4 r v / a^2,   a^2 = (r + v)^2 + z^2

with A(v) the area in which discs of both radii overlap at the distance v of their centres, and K
the complete elliptic integral: two discs are as many pairs of points as their overlap is large, and
those of one displacement v in all directions make a ring. It is the same as the Fourier-Bessel form
2 pi mu0 M^2 R^2 int J0(kr) J1(kR)^2 (1 - exp(-kh)) / k^2 dk, without its oscillations.

Far away it is the dipoles' energy times 1 + (3/2) b / r^2 + ..., and b is the sum of what each disc
brings, `squared_distance_shift`. As (1 - b/r^2)^(-3/2) begins in the same manner, dipoles at the distance
rho = sqrt(r^2 - b) are much closer to discs than dipoles at r: that, with one term more, is what is
summed over all pairs, and a table over the close ones makes up for the rest (`granular.pairs.disc_law`).

Where both faces are in one plane, the force is singular at contact as x^(3/2), x = r - R1 - R2;
else as the real part of (x + iz)^(3/2): `contact_force_singularity`.

The torque of two uniformly magnetised discs with equal tilts: the load on the plates is made of it.

Two dipoles tilted in the same sense by a small angle t, in the plane of their axes, tilt each other further
with the torque 3 t / r^3 (in units of mu0 m1 m2 / (4 pi)). Two discs turned by t about their centres are
level in a frame turned by t, one lifted by r t: the torque on the first is t r dT/dz of level discs, z the
height of the second above the first. Its face charges at the heights z1 = +-h1/2 give

    dT/dz = sum +-(z1 d2U/(dr dz) - d2W/dz2),   W(r, z) = integral of x1/distance over both faces

with U and its rings as in `granular.pairs.disc_law`, and x1 counted from the first disc's axis towards the
second: W has the first moment v S(v) of the overlap for its area A(v), S the segment of the second disc.

Far away the torque over the dipoles' is 1 + kappa/r^2 + ..., kappa = (15/2) b1 + (5/2) b2, b that of
`squared_distance_shift`: an octupole e/r^5 of the energy turns its own disc by 15 e and the other by 5 e,
where dipoles have 3. So with rho, s and c of `granular.pairs.disc_law` the load has for 1/r^3

    rho^2 (s + c s^2) + (6 b1 + b2) s + d s^2,

exact up to r^-5. Beyond the tables of the energy a fitted d keeps it within 1e-4 of the load at contact and
2e-3 of itself; nearer pairs have the difference tabulated. At contact the torque's slope is infinite, as
that of the root of r - R1 - R2.

Discs as kernels take them: a sum over all pairs, and the near part of the law.

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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from granular.pairs.dipole_law import ENERGY
from granular.pairs.direct_sum import pad_values
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
from granular.shared.array_types import Float, Int
from granular.shared.errors import InputError

__all__ = ["Disc", "disc_energy_and_force"]

Samples = NDArray[np.float64]

_NODES, _EXTENT = 60, 3.4
"""Nodes on each side of the middle, and where they end, of the double-exponential quadrature
(Takahasi and Mori 1974, doi:10.2977/prims/1195192451), which ends in singularities do not harm."""


class Disc(NamedTuple):
    """A disc.

    Attributes
    ----------
    radius, height : float
        Both in one unit of length.
    """

    radius: float
    height: float


def squared_distance_shift(disc: Disc) -> float:
    """Contribution of a disc to b = r^2 - rho^2, with level mid-planes: (3/4) (R^2 - h^2/3)."""
    return 0.75 * (disc.radius**2 - disc.height**2 / 3.0)


def pair_squared_distance_shift(first: Disc, second: Disc) -> float:
    """Shift b of the squared distance at which two dipoles repel as two discs do far away."""
    return squared_distance_shift(first) + squared_distance_shift(second)


def contact_distance(first: Disc, second: Disc) -> float:
    """Distance of the axes at which two discs touch: the sum of their radii."""
    return first.radius + second.radius


def disc_energy_and_force(r: Samples, first: Disc, second: Disc) -> tuple[Samples, Samples]:
    """Energy and repulsion of two discs over those scales for which dipoles have 1/r^3 and 3/r^4.

    Parameters
    ----------
    r : float (n,)
        Distances of the axes, from contact on; in the unit of the discs.
    first, second : Disc
        The two discs, whose mid-planes are level.

    Returns
    -------
    tuple of float64 (n,)
        Energy over mu0 m1 m2 / (4 pi), and force over the same.
    """
    energy, force = np.zeros((2, len(r)))
    for z, sign in (
        (0.5 * abs(first.height - second.height), 2.0),
        (0.5 * (first.height + second.height), -2.0),
    ):
        of_faces, slope = _face_pair_energy(np.asarray(r, dtype=np.float64), z, first, second)
        energy += sign * of_faces
        force -= sign * slope
    return energy / disc_volumes(first, second), force / disc_volumes(first, second)


def contact_force_singularity(first: Disc, second: Disc) -> tuple[float, float]:
    """Singular part of the force at contact: factor and height z of factor Re (x + iz)^(3/2)."""
    reduced = first.radius * second.radius / (first.radius + second.radius)
    # In the units of `disc_energy_and_force`. The two pairs of nearest faces alone: others are smooth at
    # contact.
    factor = 2.0 * 8.0 * np.pi / 3.0 * np.sqrt(2.0 * reduced)
    return float(factor / disc_volumes(first, second)), 0.5 * abs(first.height - second.height)


def disc_volumes(first: Disc, second: Disc) -> float:
    """Product of the volumes of two discs."""
    return float(np.pi**2 * (first.radius * second.radius) ** 2 * first.height * second.height)


def _tanh_sinh_nodes() -> tuple[Samples, Samples, Samples]:
    """Nodes on (0, 1), what lies between them and 1, and their weights."""
    k = np.linspace(-_EXTENT, _EXTENT, 2 * _NODES + 1)
    u = 0.5 * np.pi * np.sinh(k)
    weight = 0.25 * np.pi * (k[1] - k[0]) * np.cosh(k) / np.cosh(u) ** 2
    return 1.0 / (1.0 + np.exp(-2.0 * u)), 1.0 / (1.0 + np.exp(2.0 * u)), weight


def overlap_nodes(first: Disc, second: Disc) -> tuple[Samples, Samples, Samples, Samples]:
    """Displacements v, contact less v, weights, and both discs' segments of the overlap (2, n) at v."""
    low, high = abs(first.radius - second.radius), contact_distance(first, second)
    left, right, weight = _tanh_sinh_nodes()
    ends = np.array([0.0, low, high] if low > 0.0 else [low, high])[:, None]
    width = np.diff(ends, axis=0)
    v, below = (ends[:-1] + width * left).ravel(), (high - ends[1:] + width * right).ravel()
    s = np.sqrt(below * np.maximum(v - low, 0.0) * (v + low) * (v + high))
    squares = np.array([[first.radius**2], [second.radius**2]])
    angles = 2.0 * np.arctan2(s, v**2 + squares - squares[::-1])
    return v, below, (width * weight).ravel(), 0.5 * squares * _angle_less_sine(angles)


def _angle_less_sine(x: Samples) -> Samples:
    """Difference x - sin(x), also of small angles."""
    square = x * x
    series = x * square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0)))
    return np.where(x < 0.1, series, x - np.sin(x))


def ring_integrals(r: Samples, v: Samples, apart: Samples, z: float) -> tuple[Samples, Samples, Samples]:
    """Integrals over a ring of 1/d, 1/d^3 and 1/d^5, d the distance of a point at r and the height z."""
    from scipy.special import ellipe, ellipkm1

    a2, b2 = (r + v) ** 2 + z * z, apart**2 + z * z
    ratio = b2 / a2
    first, second, scale = ellipkm1(ratio), ellipe(1.0 - ratio), 4.0 / np.sqrt(a2)
    fifth = (2.0 * (1.0 + ratio) * second - ratio * first) / (3.0 * b2 * b2)
    return scale * first, scale * second / b2, scale * fifth


def _face_pair_energy(r: Samples, z: float, first: Disc, second: Disc) -> tuple[Samples, Samples]:
    """U of the head of this file, and its derivative by r."""
    v, below, weights, segments = overlap_nodes(first, second)
    across = r[:, None]
    # By the distances from contact: v itself is rounded.
    apart = across - contact_distance(first, second) + below
    inverse, cube, _ = ring_integrals(across, v, apart, z)
    slope = -0.5 / across * (inverse + (apart * (across + v) - z * z) * cube)
    amounts = segments.sum(axis=0) * v * weights
    return inverse @ amounts, slope @ amounts


LOAD_FIFTH = 10.0
"""Factor of r^-5 beside r^-3 in the load over b of one of two equal discs: kappa."""


def disc_torque_over_dipoles(r: Samples, first: Disc, second: Disc) -> Samples:
    """Torque on the first of two equally tilted discs over that of dipoles (n,); r (n,), from contact on."""
    v, below, weights, segments = overlap_nodes(first, second)
    across = r[:, None]
    apart = across - contact_distance(first, second) + below
    total = np.zeros(len(r))
    # The first disc's upper face with both of the second's; the lower face has the same again.
    for height, sign in ((second.height - first.height, 1.0), (-second.height - first.height, -1.0)):
        z = 0.5 * height
        inverse, cube, fifth = ring_integrals(across, v, apart, z)
        less, square = apart * (across + v) - z * z, across**2 + v**2 + z * z
        lifted = 1.5 * z * first.height * (less * fifth + cube)
        moment = (square + 3.0 * z * z) * cube - inverse - 3.0 * z * z * square * fifth
        total += sign * (lifted @ (segments.sum(axis=0) * v * weights) + moment @ (segments[1] * v * weights))
    return r**3 / 3.0 * total / disc_volumes(first, second)


def disc_load(r: Samples, first: Disc, second: Disc) -> Samples:
    """Value for 1/r^3 in the load on the first of two discs (n,), constant below contact; r (n,)."""
    r = np.maximum(r, contact_distance(first, second))
    # Thin discs turn tall ones back when they are close; the load is a magnitude.
    return np.abs(disc_torque_over_dipoles(r, first, second)) / r**3


def disc_load_law(r: Samples, first: Disc, second: Disc, c: float, term: float) -> Samples:
    """Value for 1/r^3 in the load on the first disc as the sum over all pairs has it (n,); r (n,)."""
    square = r * r - pair_squared_distance_shift(first, second)
    s = square**-2.5
    shift = 6.0 * squared_distance_shift(first) + squared_distance_shift(second)
    return np.asarray(square * (s + c * s * s) + shift * s + term * s * s)


def fit_load_term(pairs: Sequence[tuple[Disc, Disc]], begins: Sequence[float], c: float) -> float:
    """Fit d of the head of this file to pairs of discs, each from a distance on."""
    products, squares = 0.0, 0.0
    for pair, begin in zip(pairs, begins, strict=True):
        r = np.geomspace(begin, max(begin, _BEYOND * contact_distance(*pair)), 100)
        exact = disc_load(r, *pair)
        # By the area of a ring: what matters is the sum over neighbours.
        error, slope = ((disc_load_law(r, *pair, c, term) - exact) * r for term in (0.0, 1.0))
        slope = slope - error
        products, squares = products + float(error @ slope), squares + float(slope @ slope)
    return -products / squares


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
