"""Spatial correlations compared with brute-force computation; order and motion as functions of time."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad

from granular.observables import (
    bond_correlation,
    bond_relaxation,
    lindemann_parameter,
    local_psi6,
    mean_square_displacement,
    non_affine_motion,
    non_affine_series,
    per_distance,
    per_lag,
    radial_distribution,
    voronoi_cells,
)
from granular.shared.errors import InputError

from .conftest import MakeRun, hexagonal, rotated


def distances(points: np.ndarray) -> np.ndarray:
    """Return the distances of all pairs i < j, by brute force."""
    i, j = np.triu_indices(len(points), 1)
    return np.sqrt(((points[i] - points[j]) ** 2).sum(axis=1))


def share_nearer(a: float, b: float, r: float) -> float:
    """Return the fraction of pairs of uniform points in a rectangle a x b that are closer than r, by
    quadrature.
    """

    def strip(x: float) -> float:
        y = np.sqrt(max(r * r - x * x, 0.0))
        return 2.0 * (a - x) / a**2 * (2.0 * b * y - y**2) / b**2

    return quad(strip, 0.0, r, epsabs=1e-15, epsrel=1e-13, limit=200)[0]


def brute_force(points: np.ndarray, edges: np.ndarray) -> np.ndarray:
    gaps = distances(points)
    a, b = np.ptp(points, axis=0)
    total = len(points) * (len(points) - 1) / 2
    nearer = np.array([share_nearer(a, b, r) for r in edges])
    counts = [np.sum((gaps > lo) & (gaps <= hi)) for lo, hi in itertools.pairwise(edges)]
    return np.array(counts) / (total * np.diff(nearer))


@pytest.mark.parametrize("lattice", [False, True])
def test_radial_distribution_agrees_with_brute_force_computation(
    lattice: bool, random: np.random.Generator
) -> None:
    points = hexagonal(20, 17) if lattice else random.random((300, 2)) * [3.0, 1.3]
    shorter = np.ptp(points, axis=0).min()
    edges = np.linspace(0.0, 0.997 * shorter, 41)
    # Rounding of the square root decides about pairs exactly at an edge, so there must be none.
    assert np.abs(distances(points)[:, None] - edges).min() > 1e-9
    found = radial_distribution(points, edges)
    np.testing.assert_allclose(found.values, brute_force(points, edges), rtol=1e-12, atol=1e-13)


def test_radial_distribution_ignores_grains_that_have_left_and_has_default_bins(
    random: np.random.Generator,
) -> None:
    points = random.random((80, 2)) * [2.0, 1.0]
    gaps = np.insert(points, [0, 7], np.nan, axis=0)
    found, wanted = radial_distribution(gaps), radial_distribution(points)
    np.testing.assert_array_equal(found.values, wanted.values)
    assert found.edges[-1] == pytest.approx(0.5 * np.ptp(points[:, 1]))


def test_correlations_refuse_invalid_arguments(random: np.random.Generator) -> None:
    points = random.random((30, 2))
    with pytest.raises(InputError, match="exceeds the shorter side"):
        radial_distribution(points, np.array([0.0, 1.2]))
    with pytest.raises(InputError, match="increasing"):
        radial_distribution(points, np.array([0.3, 0.2]))
    with pytest.raises(InputError, match=r"the box has the shape \(3,\)"):
        radial_distribution(hexagonal(4, 4), box=np.ones(3))
    with pytest.raises(InputError, match="outside the box"):
        radial_distribution(points, box=np.array([[0.0, 0.0], [0.5, 0.5]]))
    with pytest.raises(InputError, match="2 or more"):
        radial_distribution(points[:1])
    with pytest.raises(InputError, match="interior Voronoi cell"):
        bond_correlation(points[:3])


def test_bond_orientational_correlation_of_a_crystal_is_one() -> None:
    found = bond_correlation(hexagonal(15, 14), np.linspace(0.0, 5.0, 26))
    assert (found.pairs > 0).sum() > 10
    np.testing.assert_allclose(found.values[found.pairs > 0], 1.0, rtol=0.0, atol=1e-11)
    assert np.isnan(found.values[found.pairs == 0]).all()


def test_bond_orientational_correlation_agrees_with_brute_force_computation(
    random: np.random.Generator,
) -> None:
    points = random.random((200, 2))
    edges = np.linspace(0.0, 0.5, 16)
    found = bond_correlation(points, edges)
    inside = voronoi_cells(points).interior
    order, gaps = local_psi6(points)[inside], distances(points[inside])
    i, j = np.triu_indices(len(order), 1)
    products = (order[i].conj() * order[j]).real
    wanted = [products[(gaps > lo) & (gaps <= hi)].mean() for lo, hi in itertools.pairwise(edges)]
    np.testing.assert_allclose(found.values, wanted, rtol=0.0, atol=1e-12)


def test_correlation_averaged_over_frames_is_weighted_by_numbers_of_pairs(
    make_run: MakeRun, random: np.random.Generator
) -> None:
    frames = random.random((4, 40, 2)) * 0.06
    run = make_run(frames)
    edges = np.linspace(0.0, 0.02, 9)
    found = per_distance(run, radial_distribution, edges, start=1.0, stop=2.0)
    parts = [radial_distribution(one, edges) for one in frames[1:3]]
    wanted = sum(one.pairs for one in parts) / sum(one.weights for one in parts)
    np.testing.assert_allclose(found, wanted, rtol=1e-12)
    np.testing.assert_allclose(found["distance"], 0.5 * (edges[1:] + edges[:-1]))
    bonds = per_distance(run, bond_correlation, edges)
    each = [bond_correlation(one, edges) for one in frames]
    total = sum(np.nan_to_num(one.values) * one.pairs for one in each)
    np.testing.assert_allclose(bonds, total / sum(one.pairs for one in each), rtol=1e-10)
    assert per_distance(run, radial_distribution).sizes["distance"] == 100
    with pytest.raises(InputError, match="no frame lies"):
        per_distance(run, radial_distribution, start=9.0)


def walk(random: np.random.Generator, frames: int, step: float) -> np.ndarray:
    steps = step * random.normal(size=(frames, 500, 2))
    return np.asarray(hexagonal(25, 20)[None] + np.cumsum(steps, axis=0))


def test_mean_square_displacement_of_a_random_walk_grows_linearly_in_time(
    make_run: MakeRun, random: np.random.Generator
) -> None:
    """For independent normal steps of deviation s, <r^2> = 2 s^2 t and the Lindemann parameter is 2 s^2
    t/a^2.
    """
    frames, lags = walk(random, 60, 0.01), np.array([1, 4, 16])
    np.testing.assert_allclose(mean_square_displacement(frames, lags), 2e-4 * lags, rtol=0.05)
    np.testing.assert_allclose(lindemann_parameter(frames, lags), 2e-4 * lags, rtol=0.08)
    run = make_run(0.006 * frames)
    found = per_lag(run, mean_square_displacement)
    assert found.attrs["units"] == "m^2"
    assert float(found[0]) == pytest.approx(0.006**2 * 2e-4, rel=0.05)
    assert float(found["lag"][0]) == 1.0
    assert float(per_lag(run, lindemann_parameter)[0]) == pytest.approx(2e-4, rel=0.08)


def test_lindemann_parameter_ignores_a_common_displacement() -> None:
    """In a crystal that moves as a whole, the displacement grows while the Lindemann parameter stays 0."""
    frames = hexagonal(10, 10)[None] + 0.1 * np.arange(6.0)[:, None, None]
    assert mean_square_displacement(frames, np.array([5]))[0] == pytest.approx(0.5)
    np.testing.assert_allclose(lindemann_parameter(frames), 0.0, atol=1e-20)
    np.testing.assert_allclose(bond_relaxation(frames), 1.0, rtol=1e-9)


def test_bond_order_of_a_crystal_rotating_at_omega_has_the_time_correlation_cos_6_omega_t(
    make_run: MakeRun,
) -> None:
    omega = 0.02
    frames = np.array([rotated(hexagonal(12, 12), omega * k) for k in range(20)])
    lags = np.array([1, 5, 19])
    np.testing.assert_allclose(bond_relaxation(frames, lags), np.cos(6.0 * omega * lags), atol=1e-9)
    assert float(per_lag(make_run(0.006 * frames), bond_relaxation)[0]) == pytest.approx(
        math.cos(6.0 * omega), abs=1e-9
    )


def test_non_affine_displacement_d2min_is_zero_for_affine_strain_and_positive_for_a_hop(
    make_run: MakeRun,
) -> None:
    points = hexagonal(10, 10)
    gradient = np.array([[1.02, 0.05], [-0.01, 0.97]])
    strained = points @ gradient.T
    found = non_affine_motion(points, strained)
    inside = voronoi_cells(points).interior
    np.testing.assert_allclose(found.d2min[inside], 0.0, atol=1e-20)
    wanted = np.broadcast_to(gradient - np.eye(2), found.strain[inside].shape)
    np.testing.assert_allclose(found.strain[inside], wanted, atol=1e-10)
    assert np.isnan(found.d2min[~inside]).all()
    hop = 55
    strained[hop] += [0.3, 0.0]
    jumped = non_affine_motion(points, strained).d2min
    assert int(np.nanargmax(jumped)) != 0
    # One of six neighbours moves alone: the best local strain accounts for a third of its displacement.
    neighbours = np.flatnonzero(np.linalg.norm(points - points[hop], axis=1).round(6) == 1.0)
    np.testing.assert_allclose(
        jumped[neighbours], np.linalg.norm([0.3, 0.0]) ** 2 / 6.0 * (2.0 / 3.0), rtol=1e-6
    )
    series = non_affine_series(make_run(0.006 * np.array([points, points, strained])))
    assert np.isnan(series.values[0]).all()
    assert float(series[1].max()) == pytest.approx(0.0, abs=1e-20)
    assert float(series[2, neighbours[0]]) == pytest.approx(0.006**2 * jumped[neighbours[0]])


def test_time_correlations_with_invalid_lags_or_frames_are_refused(make_run: MakeRun) -> None:
    frames = np.array([hexagonal(6, 6)] * 4)
    with pytest.raises(InputError, match="use 1 to 3 frames"):
        mean_square_displacement(frames, np.array([4]))
    with pytest.raises(InputError, match=r"\(f, n, 2\)"):
        lindemann_parameter(frames[0])
    with pytest.raises(InputError, match="periods"):
        lindemann_parameter(frames, periods=(0.0, 1.0))
    run = make_run(0.006 * frames)
    run.dataset["frame_time"] = ("frame", np.array([0.0, 1.0, 2.0, 9.0]))
    with pytest.raises(InputError, match="within one stage"):
        per_lag(run, mean_square_displacement)
