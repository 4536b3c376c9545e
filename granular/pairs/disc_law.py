"""The law of two uniformly magnetized discs with axes normal to the plates.

Magnetization that ends at a face acts as a magnetic surface charge there. The energy is therefore a sum over
pairs of faces, E = (mu0 M1 M2 / 4 pi) sum +-U(r, z). Here z is the height of one face above the other, and

    U(r, z) = integral of 1/distance over both faces
            = integral over v of A(v) v 4 K(m) / a,   m = 4 r v / a^2,   a^2 = (r + v)^2 + z^2

where A(v) is the overlap area of discs of both radii whose centres are at a distance v, and K the
complete elliptic integral. The number of pairs of points with displacement v is proportional to the
overlap, and displacements of length v in all directions form a ring. The integral equals the
Fourier-Bessel form 2 pi mu0 M^2 R^2 int J0(kr) J1(kR)^2 (1 - exp(-kh)) / k^2 dk,
whose integrand oscillates.

Far away the energy is the dipoles' energy times 1 + (3/2) b / r^2 + ..., where b is the sum of
contributions of both discs, `squared_distance_shift`. Since (1 - b/r^2)^(-3/2) has the same leading
terms, dipoles at the distance rho = sqrt(r^2 - b) approximate discs much better than dipoles at r.
The sum over all pairs uses this law with one more term; a table corrects close pairs.

With x = r - R1 - R2, the force is singular at contact as x^(3/2) if both faces are in one plane, and
otherwise as the real part of (x + iz)^(3/2); see `contact_singularity_factor_and_height`.

The load on the plates follows from the torque of two uniformly magnetized discs with equal tilts.

Let two dipoles be tilted in the same sense by a small angle t, in the plane of their axes. They tilt each
other further with the torque 3 t / r^3 (in units of mu0 m1 m2 / (4 pi)). Two discs turned by t about their
centres have no tilt in a frame that is also turned by t, but one is then higher than the other by r t. The
torque on the first disc is therefore t r dT/dz. Here T(r, z) is the torque on the first disc if neither disc
is tilted and the second one is higher by z. The face charges at z1 = +-h1/2 give

    dT/dz = sum +-(z1 d2U/(dr dz) - d2W/dz2),   W(r, z) = integral of x1/distance over both faces

with U and the rings as above, and x1 measured from the first disc's axis towards the second. The integral for
W contains the first moment v S(v) of the overlap in place of its area A(v), where S is the area of the second
disc's segment of the overlap.

Far away the ratio of the torque to the dipoles' torque is 1 + kappa/r^2 + ..., with
kappa = (15/2) b1 + (5/2) b2 and b from `squared_distance_shift`: an octupole term e/r^5 of the energy exerts
a torque 15 e on the disc with the octupole and 5 e on the other, compared with 3 for dipoles. With rho
as above, s = rho^-5 and a fitted c (see the last paragraphs), the load contains, in place of 1/r^3,

    rho^2 (s + c s^2) + (6 b1 + b2) s + d s^2,

which is exact up to r^-5. The coefficient d is fitted. Beyond the range of the energy's tables the error is
then below 1e-4 of the load at contact, and below 2e-3 of the load at r. For nearer pairs the difference from
the exact load is tabulated. At contact the slope
of the torque is infinite, like the slope of the square root of r - R1 - R2.

For the compiled loops the law is split into a sum over all pairs and a near part. The sum over all pairs is
(natural units, without moments, rho^2 = r^2 - b)

    E = (1/4) (rho^-3 + c rho^-8),   F/r = (3/4) (rho^-5 + (8/3) c rho^-10),

the dipoles' law at another distance plus one term. With s = rho^-5 the force contains a completed square,

    s + (8/3) c s^2 = (8/3) c ((s + g)^2 - g^2),   g = 3/(16 c),

so it costs no more than the force of dipoles. The shift b makes the far field exact up to the second
multipole; c is fitted to the exact law beyond a certain distance. For nearer pairs the difference is added by
`granular.pairs.near_law`. Below contact the force is continued with its value and slope at contact.
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
    STOP,
    NearLaw,
    NearTables,
    SeriesTerms,
    collision_frequency_table,
    join_collision_frequency_tables,
    make_near_law,
    species_pairs_and_indices,
)
from granular.pairs.piecewise import Sampled, tabulate_energies, tabulate_values
from granular.pairs.simd import DISC_SCALE
from granular.shared.array_types import Float, Int
from granular.shared.errors import InputError

__all__ = ["Disc", "disc_energy_and_force"]

Samples = NDArray[np.float64]

_NODES, _EXTENT = 60, 3.4
"""Number of quadrature nodes on each side of the middle, and limit of the transformed variable.

The double-exponential quadrature tolerates singularities at the ends (Takahasi and Mori 1974,
doi:10.2977/prims/1195192451).
"""


class Disc(NamedTuple):
    """A disc.

    Attributes
    ----------
    radius, height : float
        Radius and height, in the same unit of length.
    """

    radius: float
    height: float


def squared_distance_shift(disc: Disc) -> float:
    """Return a disc's contribution to b = r^2 - rho^2: (3/4) (R^2 - h^2/3), for discs at equal height."""
    return 0.75 * (disc.radius**2 - disc.height**2 / 3.0)


def pair_squared_distance_shift(first: Disc, second: Disc) -> float:
    """Return the shift b = r^2 - rho^2: two distant discs at r repel each other like two dipoles at rho."""
    return squared_distance_shift(first) + squared_distance_shift(second)


def contact_distance(first: Disc, second: Disc) -> float:
    """Return the distance of the axes of two discs in contact: the sum of their radii."""
    return first.radius + second.radius


def disc_energy_and_force(r: Samples, first: Disc, second: Disc) -> tuple[Samples, Samples]:
    """Compute energy and repulsion of two discs, in units in which dipoles have 1/r^3 and 3/r^4.

    Parameters
    ----------
    r : float (n,)
        Distances of the axes, contact or larger, in the unit of the discs.
    first, second : Disc
        The two discs, with their mid-planes at equal height.

    Returns
    -------
    tuple of float64 (n,)
        Energy and force, both in units of mu0 m1 m2 / (4 pi).
    """
    energy, force = np.zeros((2, len(r)))
    for z, sign in (
        (0.5 * abs(first.height - second.height), 2.0),
        (0.5 * (first.height + second.height), -2.0),
    ):
        face_energy, slope = _face_pair_energy_and_derivative(
            np.asarray(r, dtype=np.float64), z, first, second
        )
        energy += sign * face_energy
        force -= sign * slope
    return energy / product_of_disc_volumes(first, second), force / product_of_disc_volumes(first, second)


def contact_singularity_factor_and_height(first: Disc, second: Disc) -> tuple[float, float]:
    """Return factor and z of factor * Re (x + iz)^(3/2), the singular part of the force at contact."""
    reduced = first.radius * second.radius / (first.radius + second.radius)
    # In the units of `disc_energy_and_force`. Only the two pairs of nearest faces contribute; the others are
    # smooth at contact.
    factor = 2.0 * 8.0 * np.pi / 3.0 * np.sqrt(2.0 * reduced)
    return float(factor / product_of_disc_volumes(first, second)), 0.5 * abs(first.height - second.height)


def product_of_disc_volumes(first: Disc, second: Disc) -> float:
    return float(np.pi**2 * (first.radius * second.radius) ** 2 * first.height * second.height)


def _tanh_sinh_nodes_and_weights() -> tuple[Samples, Samples, Samples]:
    """Return nodes on (0, 1), their distances from 1, and their weights."""
    k = np.linspace(-_EXTENT, _EXTENT, 2 * _NODES + 1)
    u = 0.5 * np.pi * np.sinh(k)
    weight = 0.25 * np.pi * (k[1] - k[0]) * np.cosh(k) / np.cosh(u) ** 2
    return 1.0 / (1.0 + np.exp(-2.0 * u)), 1.0 / (1.0 + np.exp(2.0 * u)), weight


def overlap_nodes_distances_weights_and_areas(
    first: Disc, second: Disc
) -> tuple[Samples, Samples, Samples, Samples]:
    """Return four arrays: nodes v; R1 + R2 - v; weights; areas (2, n) of the two segments of the overlap."""
    low, high = abs(first.radius - second.radius), contact_distance(first, second)
    left, right, weight = _tanh_sinh_nodes_and_weights()
    ends = np.array([0.0, low, high] if low > 0.0 else [low, high])[:, None]
    width = np.diff(ends, axis=0)
    v, below = (ends[:-1] + width * left).ravel(), (high - ends[1:] + width * right).ravel()
    s = np.sqrt(below * np.maximum(v - low, 0.0) * (v + low) * (v + high))
    squares = np.array([[first.radius**2], [second.radius**2]])
    angles = 2.0 * np.arctan2(s, v**2 + squares - squares[::-1])
    return v, below, (width * weight).ravel(), 0.5 * squares * _angle_minus_sine(angles)


def _angle_minus_sine(x: Samples) -> Samples:
    """Return x - sin(x), accurate also for small angles."""
    square = x * x
    series = x * square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0)))
    return np.where(x < 0.1, series, x - np.sin(x))


def ring_integrals(r: Samples, v: Samples, apart: Samples, z: float) -> tuple[Samples, Samples, Samples]:
    """Integrate 1/d, 1/d^3, 1/d^5 over a ring of radius v; d: distance to a point at r and height z."""
    from scipy.special import ellipe, ellipkm1

    a2, b2 = (r + v) ** 2 + z * z, apart**2 + z * z
    ratio = b2 / a2
    first, second, scale = ellipkm1(ratio), ellipe(1.0 - ratio), 4.0 / np.sqrt(a2)
    fifth = (2.0 * (1.0 + ratio) * second - ratio * first) / (3.0 * b2 * b2)
    return scale * first, scale * second / b2, scale * fifth


def _face_pair_energy_and_derivative(
    r: Samples, z: float, first: Disc, second: Disc
) -> tuple[Samples, Samples]:
    """Return U(r, z) of the module's docstring, and its derivative with respect to r."""
    v, below, weights, segments = overlap_nodes_distances_weights_and_areas(first, second)
    across = r[:, None]
    # From the distances to contact, since v itself is rounded.
    apart = across - contact_distance(first, second) + below
    inverse, cube, _ = ring_integrals(across, v, apart, z)
    slope = -0.5 / across * (inverse + (apart * (across + v) - z * z) * cube)
    amounts = segments.sum(axis=0) * v * weights
    return inverse @ amounts, slope @ amounts


LOAD_FIFTH = 10.0
"""Ratio kappa/b for two equal discs, whose load is proportional to r^-3 + kappa r^-5 + ... at large r."""


def disc_torque_over_dipoles(r: Samples, first: Disc, second: Disc) -> Samples:
    """Return the torque (n,) on the first of two equally tilted discs divided by the torque on a dipole."""
    v, below, weights, segments = overlap_nodes_distances_weights_and_areas(first, second)
    across = r[:, None]
    apart = across - contact_distance(first, second) + below
    total = np.zeros(len(r))
    # The first disc's upper face with both faces of the second disc; its lower face contributes the same.
    for height, sign in ((second.height - first.height, 1.0), (-second.height - first.height, -1.0)):
        z = 0.5 * height
        inverse, cube, fifth = ring_integrals(across, v, apart, z)
        less, square = apart * (across + v) - z * z, across**2 + v**2 + z * z
        lifted = 1.5 * z * first.height * (less * fifth + cube)
        moment = (square + 3.0 * z * z) * cube - inverse - 3.0 * z * z * square * fifth
        total += sign * (lifted @ (segments.sum(axis=0) * v * weights) + moment @ (segments[1] * v * weights))
    return r**3 / 3.0 * total / product_of_disc_volumes(first, second)


def disc_pair_load(r: Samples, first: Disc, second: Disc) -> Samples:
    """Return the value (n,) that replaces 1/r^3 in the first disc's load; constant for r below contact."""
    r = np.maximum(r, contact_distance(first, second))
    # Close thin discs turn tall ones back upright; the load is a magnitude.
    return np.abs(disc_torque_over_dipoles(r, first, second)) / r**3


def approximate_disc_pair_load(r: Samples, first: Disc, second: Disc, c: float, term: float) -> Samples:
    """Return the approximation (n,) to `disc_pair_load` that the sum over all pairs uses."""
    square = r * r - pair_squared_distance_shift(first, second)
    s = square**-2.5
    shift = 6.0 * squared_distance_shift(first) + squared_distance_shift(second)
    return np.asarray(square * (s + c * s * s) + shift * s + term * s * s)


def fit_load_coefficient(pairs: Sequence[tuple[Disc, Disc]], begins: Sequence[float], c: float) -> float:
    """Fit d of the module's docstring to pairs of discs, each beyond its distance in ``begins``."""
    products, squares = 0.0, 0.0
    for pair, begin in zip(pairs, begins, strict=True):
        r = np.geomspace(begin, max(begin, _MAX_DISTANCE * contact_distance(*pair)), 100)
        exact = disc_pair_load(r, *pair)
        # Weighted by the area of a ring, since the load is a sum over neighbours.
        error, slope = ((approximate_disc_pair_load(r, *pair, c, term) - exact) * r for term in (0.0, 1.0))
        slope = slope - error
        products, squares = products + float(error @ slope), squares + float(slope @ slope)
    return -products / squares


TOLERANCE, RELATIVE = 9e-7, 9e-6
"""Allowed error of energy and force at a distance r beyond the tables: `TOLERANCE` times the value at
contact, or `RELATIVE` times the value at r, whichever is larger.
"""

CLOSEST = 0.98
"""Distance at which a simulation stops, divided by the contact distance."""

_TABLE_ERROR = 1e-12
"""Relative error of the tabulated energy; beyond contact the force then has relative errors below 1e-8."""

_LOAD_ERROR = 1e-6
"""Relative error of the tabulated load."""

_WINDOW = 1.01
"""Ratio of the end of a table to the distance from which the all-pairs law is valid. Between these two
distances the tabulated correction decreases to zero.
"""

_REACHES = np.arange(1.3, 8.01, 0.05)
"""Candidates for the end of the tables, in units of the largest contact distance."""

_MAX_DISTANCE = 40.0
"""Maximum distance considered, in units of the contact distance."""

_MIN_TERM = 0.004
"""Lower bound of abs(c): completing the square causes rounding errors of 1e-17 / c times the force at r = D.
"""


class DiscSeries(NamedTuple):
    """Coefficients of the sum over all pairs of discs; see the module's docstring."""

    coefficients: Float[np.ndarray, "8"]  # see `granular.pairs.grain_arrays.COMMON`
    shift: Float[np.ndarray, "m"] | None  # contribution of each grain to b [D^2]; None: equal for all grains


class _ExactDiscPair(NamedTuple):
    """Two discs, and their exact law at distances from contact on, in units of `disc_energy_and_force`."""

    discs: tuple[Disc, Disc]
    r: Samples
    energy: Samples
    force: Samples

    @property
    def squared_distance_shift(self) -> float:
        return pair_squared_distance_shift(*self.discs)

    def errors_over_tolerance(self, begin: float, c: float) -> Samples:
        """Return the errors of the all-pairs law beyond a distance, each divided by the allowed error."""
        energy, force = _all_pairs_law_energy_and_force(self.r, self.squared_distance_shift, c)
        chosen = self.r >= begin
        return np.concatenate(
            [
                ((law - exact) / np.maximum(TOLERANCE * exact[0], RELATIVE * exact))[chosen]
                for law, exact in ((energy, self.energy), (force, self.force))
            ]
        )


def _all_pairs_law_energy_and_force(r: Samples, shift: float, c: float) -> tuple[Samples, Samples]:
    """Return energy and force of the law for all pairs, in units of `disc_energy_and_force`."""
    rho = np.sqrt(r * r - shift)
    return rho**-3 + c * rho**-8, r * (3.0 * rho**-5 + 8.0 * c * rho**-10)


def make_all_pairs_and_near_disc_laws(
    discs: Sequence[Disc],
    species: Int[np.ndarray, "n"],
    factor: Float[np.ndarray, "m"] | None = None,
    strength: float = 1.0,
    periods: tuple[float, float] | None = None,
    *,
    loads: bool = False,
) -> tuple[DiscSeries, NearLaw]:
    """Make the all-pairs part and the near part of the law of discs; ``factor``: moments of the grains."""
    coefficients, tables = (
        _disc_series_coefficients_and_near_tables_with_loads
        if loads
        else _disc_series_coefficients_and_near_tables
    )(tuple(discs))
    shift = pad_values(np.array([squared_distance_shift(discs[k]) for k in species]))
    coefficients, mean = coefficients.copy(), float(shift[: len(species)].mean()) if len(species) else 0.0
    coefficients[FAR], coefficients[LOAD_FAR] = 3.0 * mean, LOAD_FIFTH * mean
    near = make_near_law(tables, [2.0 * disc.radius for disc in discs], species, factor, strength, periods)
    return DiscSeries(coefficients, None if len(discs) == 1 else shift), near


@functools.cache
def _disc_series_coefficients_and_near_tables(
    discs: tuple[Disc, ...],
) -> tuple[Float[np.ndarray, "8"], NearTables]:
    """Return the coefficients of the sum over all pairs, and the tables of the near part."""
    indices, rows = species_pairs_and_indices(len(discs))
    pairs = [_make_exact_pair(discs[i], discs[j]) for i, j in indices]
    c, centre = _round_coefficient_for_exact_square_of_root(_fit_energy_coefficient(pairs))
    begins = [_law_validity_distance(pair, c) for pair in pairs]
    common = 2.0 * squared_distance_shift(discs[0]) if len(discs) == 1 else 0.0
    slope = max(
        _maximum_stiffness_over_dipoles(pair, begin, c) for pair, begin in zip(pairs, begins, strict=True)
    )
    low, high = 0.95 * CLOSEST * min(pair.r[0] for pair in pairs), _WINDOW * max(begins)
    sampled = [
        _make_near_energy_function(pair.discs, begin, c) for pair, begin in zip(pairs, begins, strict=True)
    ]
    numbers = [
        [1.0, pair.squared_distance_shift, (CLOSEST * pair.r[0]) ** 2, (_WINDOW * begin) ** 2]
        for pair, begin in zip(pairs, begins, strict=True)
    ]
    tables = NearTables(
        energies=tabulate_energies(sampled, low**2, 1.05 * high**2, _TABLE_ERROR, rows),
        pairs=np.array(numbers)[rows],
        series=SeriesTerms(c, slope),
        collisions=join_collision_frequency_tables(
            [_collision_frequency_table(pair) for pair in pairs if pair.discs[0] == pair.discs[1]]
        ),
    )
    return np.array([common, c, centre, 0.5 * DISC_SCALE / centre, 0.0, slope, 0.0, 0.0]), tables


def _collision_frequency_table(pair: _ExactDiscPair) -> Samples:
    """Tabulate squared speeds and squared frequencies of head-on collisions of equal discs."""
    r = pair.r[0] * np.append(np.linspace(CLOSEST, 1.0, 20)[:-1], pair.r / pair.r[0])
    return collision_frequency_table(
        r, ENERGY * disc_energy_and_force_continued_below_contact(r, pair.discs)[0]
    )


def _make_exact_pair(first: Disc, second: Disc) -> _ExactDiscPair:
    contact = contact_distance(first, second)
    r = np.geomspace(contact, _MAX_DISTANCE * contact, 400)
    return _ExactDiscPair((first, second), r, *disc_energy_and_force(r, first, second))


def _fit_energy_coefficient(pairs: Sequence[_ExactDiscPair]) -> float:
    """Fit c so that the all-pairs law meets the tolerance from the shortest possible distance on."""
    longest = max(pair.r[0] for pair in pairs)
    for begin in _REACHES * longest:
        at_zero = np.concatenate([pair.errors_over_tolerance(begin, 0.0) for pair in pairs])
        slopes = np.concatenate([pair.errors_over_tolerance(begin, 1.0) for pair in pairs]) - at_zero
        # Iterated weighted least squares minimize the maximum error (Lawson 1961).
        weights = np.ones(len(at_zero))
        for _ in range(30):
            c = -float(weights * slopes @ at_zero / (weights * slopes @ slopes))
            errors = np.abs(at_zero + c * slopes)
            if errors.max() <= 1.0 and abs(c) >= _MIN_TERM:
                return c
            weights *= errors / errors.max()
    height = max(disc.height / (2.0 * disc.radius) for pair in pairs for disc in pair.discs)
    raise InputError(
        f"grains.magnets = 'cylinders': discs with a height of {height:.3g} diameters differ from "
        f"dipoles even beyond {_REACHES[-1]:g} diameters, the limit of the correction; use flatter "
        "discs, or 'dipoles'"
    )


def _round_coefficient_for_exact_square_of_root(c: float) -> tuple[float, float]:
    """Return c and g / `DISC_SCALE`, rounded so that g squared is exact and padding contributes exactly 0."""
    centre = float(np.float32(3.0 / (16.0 * c * DISC_SCALE)))
    return 3.0 / (16.0 * centre * DISC_SCALE), centre


def _law_validity_distance(pair: _ExactDiscPair, c: float) -> float:
    """Return the distance [D] beyond which the all-pairs law with this c meets the tolerance."""
    invalid = np.abs(pair.errors_over_tolerance(0.0, c)).reshape(2, -1).max(axis=0) > 1.0
    return float(pair.r[np.flatnonzero(invalid).max(initial=0) + 1])


def _maximum_stiffness_over_dipoles(pair: _ExactDiscPair, begin: float, c: float) -> float:
    """Return the maximum ratio, beyond ``begin``, of the stiffness to the stiffness of dipoles at rho."""
    r = pair.r[pair.r >= begin]
    u, rho = r * r, np.sqrt(r * r - pair.squared_distance_shift)
    slope = 15.0 * u * rho**-7 - 3.0 * rho**-5 + 8.0 * c * (10.0 * u * rho**-12 - rho**-10)
    return float((np.abs(slope) / (12.0 * rho**-5)).max())


@functools.cache
def _disc_series_coefficients_and_near_tables_with_loads(
    discs: tuple[Disc, ...],
) -> tuple[Float[np.ndarray, "8"], NearTables]:
    """Return coefficients and tables, including those for the load on the plates."""
    (coefficients, tables), pairs = (
        _disc_series_coefficients_and_near_tables(discs),
        list(itertools.product(discs, discs)),
    )
    c, ends = tables.series.term, np.sqrt(tables.pairs[:, END])
    coefficients, term = coefficients.copy(), fit_load_coefficient(pairs, ends, c)
    coefficients[LOAD_TERM] = term
    sampled = [_make_near_load_function(pair, end, c, term) for pair, end in zip(pairs, ends, strict=True)]
    low, high = tables.pairs[:, STOP].min(), 1.05 * tables.pairs[:, END].max()
    return coefficients, tables._replace(loads=tabulate_values(sampled, low, high, _LOAD_ERROR))


def _make_near_load_function(discs: tuple[Disc, Disc], end: float, c: float, term: float) -> Sampled:
    """Make the function of r^2 that is tabulated for loads: exact minus all-pairs value, windowed to zero."""

    def near_load_and_magnitude(u: Samples) -> tuple[Samples, Samples]:
        r = np.sqrt(u)
        exact, t = disc_pair_load(r, *discs), np.clip((end - r) / (end - end / _WINDOW), 0.0, 1.0)
        part = approximate_disc_pair_load(r, *discs, c, term)
        return (exact - part) * t**3 * (10.0 - 15.0 * t + 6.0 * t * t), exact

    return near_load_and_magnitude


_GAUSS, _WEIGHTS = np.polynomial.legendre.leggauss(12)
"""Gauss-Legendre nodes and weights on (-1, 1), which integrate the windowed force to an energy."""


def _make_near_energy_function(discs: tuple[Disc, Disc], begin: float, c: float) -> Sampled:
    """Make the energy of two discs minus the all-pairs law, windowed so that its force goes smoothly to 0."""
    shift, end = pair_squared_distance_shift(*discs), _WINDOW * begin

    def energy_force_and_slope_differences(r: Samples) -> tuple[Samples, Samples, Samples]:
        exact, part = (
            disc_energy_and_force_continued_below_contact(r, discs),
            _all_pairs_law_energy_and_force(r, shift, c),
        )
        return ENERGY * (exact[0] - part[0]), ENERGY * (exact[1] - part[1]), ENERGY * (exact[0] + part[0])

    def windowed_energy(r: Samples) -> Samples:
        """Integrate the force, multiplied by a window that goes to zero at the end of the table."""
        points = 0.5 * (end + r) + 0.5 * (end - r) * _GAUSS[:, None]
        t = np.clip((end - points) / (end - begin), 0.0, 1.0)
        force = (
            energy_force_and_slope_differences(points.ravel())[1].reshape(points.shape)
            * t**3
            * (10.0 - 15.0 * t + 6.0 * t * t)
        )
        return np.asarray(0.5 * (end - r) * (_WEIGHTS @ force))

    constant = float(
        (windowed_energy(np.array([begin])) - energy_force_and_slope_differences(np.array([begin]))[0])[0]
    )

    def near_energy_and_magnitude(u: Samples) -> tuple[Samples, Samples]:
        # All tables begin at the smallest contact distance, at which rho^2 of larger discs is negative.
        r = np.clip(np.sqrt(u), 0.9 * CLOSEST * contact_distance(*discs), end)
        energy, _, magnitude = energy_force_and_slope_differences(r)
        last = r > begin
        energy = energy + constant
        energy[last] = windowed_energy(r[last])
        return energy, magnitude

    return near_energy_and_magnitude


def disc_over_dipole_stiffness(r: Samples, discs: tuple[Disc, Disc]) -> Samples:
    """Return the stiffness of two discs divided by the stiffness of two dipoles at the same distance (n,)."""
    grid = contact_distance(*discs) * np.geomspace(CLOSEST, _MAX_DISTANCE, 300)
    slopes = np.gradient(disc_energy_and_force_continued_below_contact(grid, discs)[1], grid)
    return np.asarray(np.interp(r, grid, np.abs(slopes) * grid**5 / 12.0))


def disc_energy_and_force_continued_below_contact(
    r: Samples, discs: tuple[Disc, Disc]
) -> tuple[Samples, Samples]:
    """Return energy and force (n,) of two discs; below contact the force is continued by its tangent."""
    contact = contact_distance(*discs)
    energy, force = disc_energy_and_force(np.maximum(r, contact), *discs)
    below, slope = np.minimum(r - contact, 0.0), force_slope_at_contact(*discs)
    return energy - below * (force + 0.5 * slope * below), force + slope * below


def force_slope_at_contact(first: Disc, second: Disc) -> float:
    """Return the slope dF/dr of the repulsion of two discs at contact."""
    contact = contact_distance(first, second)
    factor, z = contact_singularity_factor_and_height(first, second)
    step = 1e-4 * contact
    x: Samples = step * np.arange(3.0)
    force = disc_energy_and_force(contact + x, first, second)[1]
    # Without the singular part, whose infinite second derivative would spoil the difference quotient.
    smooth = force - factor * _real_part_of_power(x, z, 1.5)
    slope = (-1.5 * smooth[0] + 2.0 * smooth[1] - 0.5 * smooth[2]) / step
    return float(slope + 1.5 * factor * _real_part_of_power(np.array([0.0]), z, 0.5)[0])


def _real_part_of_power(x: Samples, z: float, exponent: float) -> Samples:
    return np.asarray(((x + 1j * z) ** exponent).real * ((x > 0.0) | (z > 0.0)))
