"""Torque between two tilted magnetic discs, compared with magpylib's fields."""

import itertools

import magpylib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from granular.pairs.disc_law import (
    Disc,
    approximate_disc_pair_load,
    contact_distance,
    disc_pair_load,
    disc_torque_over_dipoles,
    fit_load_coefficient,
    make_all_pairs_and_near_disc_laws,
    squared_distance_shift,
)
from granular.pairs.grain_arrays import TERM
from tests.granular.pairs.test_discs import COIN, MU0, SMALL, TALL, THIN, face_points

TILT = np.radians(0.96)
"""Tilt of a disc of 6 x 3 mm between plates 3.1 mm apart."""


def tilted_faces(disc: Disc, tilt: np.ndarray, many: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, 3) on both faces of a tilted disc, and their magnetic charges.

    The points are relative to the disc's centre, and denser on the left.
    """
    points, weights = face_points(disc.radius, many)
    faces = [np.column_stack([points, np.full(len(points), s * 0.5 * disc.height)]) for s in (1.0, -1.0)]
    return Rotation.from_rotvec([*tilt, 0.0]).apply(np.vstack(faces)), np.concatenate([weights, -weights])


def unit_torque(first: Disc, second: Disc) -> float:
    """Return the torque unit mu0 m1 m2/(4 pi) of two discs with magnetization 1/mu0."""
    return np.pi * (first.radius * second.radius) ** 2 * first.height * second.height / (4.0 * MU0)


def torque_of_fields(r: float, first: Disc, second: Disc, tilts: np.ndarray, many: int = 100) -> np.ndarray:
    """Return the torque (3,) on the first disc about its centre, in magpylib's field of the second disc
    at +x.
    """
    source = magpylib.magnet.Cylinder(
        polarization=(0.0, 0.0, 1.0),
        dimension=(2.0 * second.radius, second.height),
        position=(r, 0.0, 0.0),
        orientation=Rotation.from_rotvec([*tilts[1], 0.0]),
    )
    points, charges = tilted_faces(first, tilts[0] * [1.0, -1.0], many)
    points[:, 0] *= -1.0  # dense on the right, and turned the other way
    torque = charges @ np.cross(points, source.getB(points)) / MU0
    return np.asarray(torque / unit_torque(first, second))


def along(first: float, second: float) -> np.ndarray:
    """Return the tilts of two discs towards +x, as rotations about x and y."""
    return np.array([[0.0, first], [0.0, second]])


@pytest.mark.parametrize(
    ("r", "known"),
    [(1.05, 2.909), (1.1, 2.509), (1.2, 2.145), (1.375, 1.829), (1.6, 1.591), (2.0, 1.358), (3.0, 1.148)],
)
def test_torque_between_two_equally_tilted_discs_has_the_known_ratio_to_dipoles(
    r: float, known: float
) -> None:
    """For dipoles, the published torque is 3 cos(t) sin(t)/r^3 at tilt t.

    Each disc is tilted about its centre.
    """
    of_dipoles = 3.0 * np.cos(TILT) * np.sin(TILT) / r**3
    of_fields = torque_of_fields(r, COIN, COIN, along(TILT, TILT))[1] / of_dipoles
    assert of_fields == pytest.approx(known, rel=1e-3)
    # Of small tilts; one degree is as much as the closest discs' gap allows.
    tolerance = 6e-3 if r == 1.05 else 2.5e-3
    assert disc_torque_over_dipoles(np.array([r]), COIN, COIN)[0] == pytest.approx(of_fields, rel=tolerance)


@pytest.mark.parametrize("pair", [(COIN, COIN), (COIN, SMALL), (SMALL, COIN), (THIN, TALL), (TALL, THIN)])
def test_disc_torque_law_for_small_tilts_is_accurate_at_every_distance(pair: tuple[Disc, Disc]) -> None:
    tilt = 1e-4
    for r in contact_distance(*pair) * np.array([1.01, 1.03, 1.1, 1.3, 1.8, 3.0, 6.0]):
        known = torque_of_fields(r, *pair, along(tilt, tilt))[1] * r**3 / (3.0 * tilt)
        assert disc_torque_over_dipoles(np.array([r]), *pair)[0] == pytest.approx(known, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("pair", [(COIN, SMALL), (SMALL, COIN), (THIN, TALL), (TALL, THIN)])
def test_torque_between_distant_discs_includes_the_next_multipole_after_the_dipole(
    pair: tuple[Disc, Disc],
) -> None:
    r = np.array([60.0, 120.0])
    excess = disc_torque_over_dipoles(r, *pair) - 1.0
    kappa = 7.5 * squared_distance_shift(pair[0]) + 2.5 * squared_distance_shift(pair[1])
    assert (excess[0] - excess[1]) / (r[0] ** -2 - r[1] ** -2) == pytest.approx(kappa, abs=1e-3)


def test_mean_friction_loads_of_discs_and_dipoles_are_the_same_fractions_of_their_maximum() -> None:
    """The fraction is 1/2 for aligned tilts, and 1/3 (to 2 %) for independent tilts at 1.2 diameters or
    more.
    """
    tilt = 1e-4
    for pair, r in itertools.product([(COIN, COIN), (COIN, SMALL)], (1.2, 1.375, 2.0)):
        # A neighbour in the direction of the tilt, and one across it; and with the other grain level.
        equal, alone = (
            [
                torque_of_fields(r, *pair, tilt * np.array([direction, k * direction]))[axis]
                for axis, direction in ((1, np.array([0.0, 1.0])), (0, np.array([1.0, 0.0])))
            ]
            for k in (1.0, 0.0)
        )
        bound = 3.0 * tilt / r**3 * disc_torque_over_dipoles(np.array([r]), *pair)[0]
        assert np.mean(equal) == pytest.approx(bound / 2.0, rel=1e-5)
        if pair == (COIN, COIN):
            assert np.mean(alone) == pytest.approx(bound / 3.0, rel=0.02)


@pytest.mark.parametrize("discs", [[COIN], [COIN, SMALL], [COIN, Disc(0.5 * 5.0 / 6.0, 0.5)], [THIN], [TALL]])
def test_friction_load_law_of_discs_is_accurate_beyond_the_tabulated_distances(discs: list[Disc]) -> None:
    """The error is below 1e-4 of the load at contact, and below 2e-3 of the load at the same distance."""
    series, law = make_all_pairs_and_near_disc_laws(discs, np.zeros(1, dtype=np.int64))
    c, pairs = series.coefficients[TERM], list(itertools.product(discs, discs))
    term = fit_load_coefficient(pairs, [law.reach] * len(pairs), c)
    for pair in pairs:
        r = np.geomspace(law.reach, 40.0 * law.reach, 50)
        exact, wrong = (disc_pair_load(r, *pair), approximate_disc_pair_load(r, *pair, c, term))
        np.testing.assert_allclose(wrong, exact, rtol=2e-3)
        touching = disc_pair_load(np.array([contact_distance(*pair)]), *pair)[0]
        np.testing.assert_allclose(wrong, exact, atol=1e-4 * touching, rtol=0.0)
        far = disc_pair_load(np.array([200.0]), *pair) / approximate_disc_pair_load(
            np.array([200.0]), *pair, c, term
        )
        assert far[0] == pytest.approx(1.0, abs=3e-8)


def test_friction_load_of_discs_is_positive_and_constant_below_contact() -> None:
    assert disc_torque_over_dipoles(np.array([1.1]), TALL, THIN)[0] < 0.0
    assert disc_pair_load(np.array([1.1]), TALL, THIN)[0] > 0.0
    below, touching = disc_pair_load(np.array([0.98, 1.0]), COIN, COIN)
    assert below == touching == pytest.approx(5.3485, rel=1e-4)
