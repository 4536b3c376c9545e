"""A wall of discs: an infinite row of disc magnets with the orientation of the grains.

The centre line of the row lies one radius behind the wall's face, so that a grain in contact with the face
touches a magnet. Let W be the distance from the centre line and x the position along the line. The energy of
a grain is the sum over the row of the energy of two discs (`granular.pairs.disc_law`), whose force is
extended smoothly to distances below contact. The sum is periodic in x with the pitch p of the row, and is a
Fourier series

    E(x, W) = A_0(W) + sum_m A_m(W) cos(2 pi m x / p),

whose terms decay as exp(-2 pi m W / p) (Poisson summation). The row is summed once per species. The few terms
that are not negligible at contact are stored as tables of W^2 A_m as functions of 1/W. At large distances A_0
is the infinite wall's energy divided by p/D. Forces are derivatives of the tables, so energy is conserved.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled, entry
from granular.effects.wall_side import (
    GrainsRelativeToWall,
    add_wall_force_to_grain,
    distance_from_wall,
    position_along_wall,
)
from granular.pairs.dipole_law import ENERGY
from granular.pairs.disc_law import (
    Disc,
    contact_distance,
    disc_energy_and_force,
    disc_energy_and_force_continued_below_contact,
    force_slope_at_contact,
    pair_squared_distance_shift,
)
from granular.pairs.grain_arrays import value_or_one
from granular.shared.array_types import Float, Int

PIECES, PHASES, SUMMED = 300, 64, 60.0
"""Three settings: the number of pieces of a table in 1/W, the number of positions per pitch at which the row
is summed, and the distance [D] along the row up to which magnets are summed individually."""

NEGLECTED_AT_CONTACT, NEGLECTED_FAR_AWAY = 1e-7, 1e-8
"""Maximum energies of neglected terms, relative to the mean energy. The first limit is for terms that are not
stored, and holds at contact; the second is for stored terms that are skipped at large distances."""


class DiscWallTables(NamedTuple):
    """Tables of the row's energy for each species."""

    pieces: Float[Array, "kinds terms PIECES 6"]  # W^2 A_m: powers of the fraction of a piece [F* D^3]
    per_piece: float  # pieces per 1/W [D]
    smooth: Float[Array, "kinds"]  # 1/W below which only the first term counts [1/D]
    wave: float  # 2 pi/pitch [1/D]
    depth: float  # distance of the row's centre line behind the face [D]
    turning: Float[Array, "2 n"]  # increasing squared speeds [D^2/tau^2]; maximum stiffness up to there


@compiled(inline=True)
def _inverse_distance_piece_position_and_term_count(
    tables: DiscWallTables, kind: int, w: float
) -> tuple[float, int, float, int]:
    """Return 1/W, the index of its piece, the position in the piece (0 to 1), and the number of terms."""
    gap = w + tables.depth
    # A grain behind the face, or at NaN, is reported elsewhere.
    if not gap > 0.5 * tables.depth:
        gap = 0.5 * tables.depth
    v = 1.0 / gap
    passed = v * tables.per_piece
    piece = min(int(passed), PIECES - 1)
    terms = 1 if v < tables.smooth[kind] else tables.pieces.shape[1]
    return v, piece, passed - piece, terms


@compiled(inline=True)
def _spline_value(p: Array, t: float) -> float:
    return p[0] + t * (p[1] + t * (p[2] + t * (p[3] + t * (p[4] + t * p[5]))))


@compiled(inline=True)
def _spline_slope(p: Array, t: float) -> float:
    return p[1] + t * (2.0 * p[2] + t * (3.0 * p[3] + t * (4.0 * p[4] + t * 5.0 * p[5])))


@compiled(inline=True)
def _spline_curvature(p: Array, t: float) -> float:
    return 2.0 * p[2] + t * (6.0 * p[3] + t * (12.0 * p[4] + t * 20.0 * p[5]))


@entry
def disc_row_energy_and_forces(
    tables: DiscWallTables, kind: int, w: float, along: float
) -> tuple[float, float, float]:
    """Return energy [F* D], normal and tangential force [F*] of a grain of moment 1; w and along in D."""
    v, piece, t, terms = _inverse_distance_piece_position_and_term_count(tables, kind, w)
    wave, cosine, sine, c, s = tables.wave, 1.0, 0.0, 1.0, 0.0
    if terms > 1:
        cosine, sine = np.cos(wave * along), np.sin(wave * along)
    energy, normal, tangential = 0.0, 0.0, 0.0
    for m in range(terms):
        p = tables.pieces[kind, m, piece]
        value, slope = _spline_value(p, t), _spline_slope(p, t) * tables.per_piece
        energy += v * v * value * c
        normal += v * v * v * (2.0 * value + v * slope) * c
        tangential += m * wave * v * v * value * s
        c, s = c * cosine - s * sine, s * cosine + c * sine
    return energy, normal, tangential


@entry
def disc_row_stiffness_bound(tables: DiscWallTables, kind: int, w: float) -> float:
    """Upper bound of the stiffness for a grain of moment 1 anywhere along the wall [F*/D]; w [D]."""
    v, piece, t, terms = _inverse_distance_piece_position_and_term_count(tables, kind, w)
    across, along, mixed = 0.0, 0.0, 0.0
    for m in range(terms):
        p, k = tables.pieces[kind, m, piece], m * tables.wave
        value, slope = _spline_value(p, t), _spline_slope(p, t) * tables.per_piece
        bend = _spline_curvature(p, t) * tables.per_piece * tables.per_piece
        across += v**4 * abs(6.0 * value + 6.0 * v * slope + v * v * bend)
        along += k * k * v * v * abs(value)
        mixed += k * v**3 * abs(2.0 * value + v * slope)
    return max(across, along) + mixed


class DiscWall(NamedTuple):
    """A row of magnets, for the compiled loop."""

    tables: DiscWallTables
    species: Int[Array, "n"] | None

    @staticmethod
    @compiled(inline=True)
    def add_forces(
        law: DiscWall,
        count: int,
        moments: Float[Array, "m"] | None,
        view: GrainsRelativeToWall,
        normal: Float[Array, "m"],
    ) -> int:
        """Add the wall's forces to the grains; store the normal forces in ``normal`` [F*]."""
        outside = 0
        for i in range(count):
            w = distance_from_wall(view, i)
            kind = _species_index_of_grain(law.species, i)
            _, normal[i], along = disc_row_energy_and_forces(
                law.tables, kind, w, position_along_wall(view, i)
            )
            normal[i] *= value_or_one(moments, i)
            add_wall_force_to_grain(view, i, normal[i], value_or_one(moments, i) * along)
            outside += not w > 0.0
        return outside

    @staticmethod
    @compiled
    def measure_energy_and_stiffness(
        law: DiscWall,
        count: int,
        view: GrainsRelativeToWall,
        slopes: Float[Array, "m"],
        energies: Float[Array, "m"],
    ) -> None:
        """Store the energies [F* D] of grains of moment 1; add upper bounds of their stiffness [F*/D]."""
        for i in range(count):
            w = distance_from_wall(view, i)
            kind = _species_index_of_grain(law.species, i)
            energies[i] = disc_row_energy_and_forces(law.tables, kind, w, position_along_wall(view, i))[0]
            slopes[i] += disc_row_stiffness_bound(law.tables, kind, w)

    @staticmethod
    @compiled
    def turning_point_stiffness(law: DiscWall, speed: float) -> float:
        """Maximum stiffness per mass [1/tau^2] on the path of a grain to the turning point; speed [D/tau]."""
        squares = law.tables.turning[0]
        return law.tables.turning[1, min(np.searchsorted(squares, speed * speed), squares.size - 1)]


@compiled(inline=True)
def _species_index_of_grain(species: Array | None, i: int) -> int:
    return 0 if species is None else species[i]


@functools.cache
def tabulate_disc_wall(
    discs: tuple[Disc, ...], magnet: Disc, moment: float, pitch: float, depth: float | None = None
) -> DiscWallTables:
    """Tabulate the energy of the row for each species; pitch, and depth of the centre line [D]."""
    depth, wave = depth or magnet.radius, 2.0 * np.pi / pitch
    v = np.linspace(0.0, 1.0 / depth, PIECES + 1)
    amplitudes = [_row_fourier_amplitudes(v, disc, magnet, pitch) for disc in discs]
    touch = [int(np.argmin(np.abs(v - 1.0 / (depth + disc.radius)))) for disc in discs]
    rests = [np.cumsum(np.abs(a[::-1, k]))[::-1] / a[0, k] for a, k in zip(amplitudes, touch, strict=True)]
    terms = max(int(np.flatnonzero(rest > NEGLECTED_AT_CONTACT).max()) + 1 for rest in rests)
    pieces = np.array([[_quintic_spline_pieces(v, row) for row in a[:terms]] for a in amplitudes])
    smooth = []
    for a in amplitudes:
        rough = np.flatnonzero(np.abs(a[1:terms]).sum(axis=0) > NEGLECTED_FAR_AWAY * a[0])
        smooth.append(v[max(int(rough.min(initial=PIECES)) - 1, 0)])
    tables = DiscWallTables(
        ENERGY * moment * pieces, PIECES * depth, np.array(smooth), wave, depth, np.zeros((2, 1))
    )
    w = 1.0 / v[1:] - depth
    squares, slopes = [], []
    for kind, a in enumerate(amplitudes):
        lower_bounds = 2.0 * ENERGY * moment * v[1:] ** 2 * (a[0] - np.abs(a[1:terms]).sum(axis=0))[1:]
        squares.append(np.maximum.accumulate(lower_bounds))
        bounds = [disc_row_stiffness_bound(tables, kind, float(distance)) for distance in w]
        slopes.append(np.maximum.accumulate(bounds))
    all_squares = np.unique(np.concatenate(squares))
    maxima = [
        slope[np.minimum(np.searchsorted(square, all_squares), len(slope) - 1)]
        for square, slope in zip(squares, slopes, strict=True)
    ]
    return tables._replace(turning=np.array([all_squares, np.max(maxima, axis=0)]))


def _row_fourier_amplitudes(v: np.ndarray, disc: Disc, magnet: Disc, pitch: float) -> np.ndarray:
    """Return W^2 A_m (PHASES / 2 + 1, n) at v = 1/W, in units of the energy of two dipoles at distance D."""
    shift, w = pair_squared_distance_shift(disc, magnet), 1.0 / v[1:]
    energy = _make_disc_pair_energy_function(disc, magnet)
    # Beyond 60 D the energy is the dipole's with the first correction, which the integral includes.
    each_way = int(np.ceil(SUMMED / pitch))
    offsets = pitch * (np.arange(PHASES)[:, None] / PHASES + np.arange(-each_way, each_way + 1))
    sums = np.empty((PHASES, len(v)))
    for k, distance in enumerate(w):
        r2 = offsets**2 + distance**2
        # The rest of the sum is an integral.
        a = distance**2 - shift
        # It starts half a pitch beyond the last magnet, by the midpoint rule.
        ends = np.abs(np.array([offsets[:, -1], offsets[:, 0]])) + 0.5 * pitch
        if a > 0.0:
            root = np.sqrt(ends**2 + a)
            rest = (1.0 / (root * (root + ends))).sum(axis=0) / pitch
        else:
            rest = (0.5 / ends**2).sum(axis=0) / pitch
        sums[:, k + 1] = distance**2 * (energy(np.sqrt(r2)).sum(axis=1) + rest)
    # W^2 times the sum of r^-3 over the row tends to 2/pitch at large W, as for the infinite wall.
    sums[:, 0] = 2.0 / pitch
    result = np.fft.rfft(sums, axis=0).real / PHASES
    # The corner lies halfway between two magnets.
    result[1:] *= 2.0 * (-1.0) ** np.arange(1, len(result))[:, None]
    result[1:, 0] = 0.0
    return np.asarray(result)


def _make_disc_pair_energy_function(disc: Disc, magnet: Disc) -> Callable[[np.ndarray], np.ndarray]:
    """Make a fast function of r: energy of two discs in units of the energy of two dipoles at distance D."""
    from scipy.interpolate import CubicSpline  # its import takes longer than a warm start of dipoles

    pair, contact = (disc, magnet), contact_distance(disc, magnet)
    shift, slope = pair_squared_distance_shift(disc, magnet), force_slope_at_contact(disc, magnet)
    # The substitution r = contact / (1 - t^2) removes the singularity at contact.
    t = np.linspace(0.0, np.sqrt(1.0 - 1.0 / 40.0), 500)
    r = contact / (1.0 - t * t)
    near = CubicSpline(t, disc_energy_and_force(r, *pair)[0] * r**3)
    first, force = (
        float(values[0])
        for values in disc_energy_and_force_continued_below_contact(np.array([contact]), pair)
    )

    def interpolated_pair_energy(r: np.ndarray) -> np.ndarray:
        t = np.sqrt(1.0 - np.minimum(contact / r, 1.0))
        factor = np.where(t < near.x[-1], near(np.minimum(t, near.x[-1])), 1.0 + 1.5 * shift / r**2)
        below = np.minimum(r - contact, 0.0)
        pressed = first - below * (force + 0.5 * slope * below)
        return np.where(below < 0.0, pressed, factor / r**3)

    return interpolated_pair_energy


def _quintic_spline_pieces(v: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Coefficients (PIECES, 6) of a quintic spline, for powers of the position (0 to 1) within a piece."""
    from scipy.interpolate import make_interp_spline

    spline, width, factorial = make_interp_spline(v, values, k=5), v[1] - v[0], 1.0
    columns = []
    for order in range(6):
        factorial *= max(order, 1)
        # In the middle of the pieces: the last derivative jumps at their ends.
        at = v[:-1] if order < 5 else v[:-1] + 0.5 * width
        columns.append(spline.derivative(order)(at) * width**order / factorial if order else spline(at))
    return np.stack(columns, axis=1)
