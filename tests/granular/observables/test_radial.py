"""g(r) and g6(r) against brute force, ideal arrangements and another library."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.integrate import quad

from granular.observables import (
    bond_correlation,
    local_psi6,
    per_distance,
    radial_distribution,
    voronoi_cells,
)
from granular.shared.errors import InputError

from .conftest import MakeRun, hexagonal


def distances(points: np.ndarray) -> np.ndarray:
    """All pairs i < j, by brute force."""
    i, j = np.triu_indices(len(points), 1)
    return np.sqrt(((points[i] - points[j]) ** 2).sum(axis=1))


def share_nearer(a: float, b: float, r: float) -> float:
    """Fraction of the pairs of uniform points in a x b that are nearer than r, by quadrature.

    The differences x and y of two points have the densities 2 (a - x)/a^2 and 2 (b - y)/b^2.
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
def test_brute_force_agrees(lattice: bool, random: np.random.Generator) -> None:
    points = hexagonal(20, 17) if lattice else random.random((300, 2)) * [3.0, 1.3]
    shorter = np.ptp(points, axis=0).min()
    edges = np.linspace(0.0, 0.997 * shorter, 41)
    # The rounding of sqrt decides about pairs at an edge: none may be there.
    assert np.abs(distances(points)[:, None] - edges).min() > 1e-9
    found = radial_distribution(points, edges)
    np.testing.assert_allclose(found.values, brute_force(points, edges), rtol=1e-12, atol=1e-13)


def test_first_shells_of_the_lattice() -> None:
    """A patch of m x n has (m - 1) n + (n - 1)(2 m - 1) bonds, and nothing is nearer."""
    m, n = 12, 10
    found = radial_distribution(hexagonal(m, n), np.array([0.5, 0.99, 1.01, 1.7, 1.75]))
    bonds = (m - 1) * n + (n - 1) * (2 * m - 1)
    second = (n - 2) * m + 2 * (n - 1) * (m - 2) + (n - 1)
    assert found.pairs.tolist() == [0, bonds, 0, second]
    assert found.values[0] == 0.0


def test_no_order_gives_one_at_every_distance(random: np.random.Generator) -> None:
    """Over many arrangements the mean is 1 within its error up to the shorter side."""
    box = np.array([[0.0, 0.0], [2.0, 1.0]])
    edges = np.linspace(0.0, 1.0, 11)
    found = [radial_distribution(random.random((60, 2)) * box[1], edges, box).values for _ in range(400)]
    error = np.std(found, axis=0) / np.sqrt(len(found))
    assert error.max() < 0.02
    assert (np.abs(np.mean(found, axis=0) - 1.0) < 4.0 * error).all()


def test_freud_counts_the_same_pairs(random: np.random.Generator) -> None:
    freud = pytest.importorskip("freud")
    points = random.random((400, 2)) * [30.0, 20.0]
    box = freud.box.Box(Lx=100.0, Ly=100.0, is2D=True)
    places = np.column_stack([points - points.mean(axis=0), np.zeros(len(points))])
    theirs = freud.density.RDF(bins=50, r_max=10.0).compute((box, places), reset=True)
    ours = radial_distribution(points, np.linspace(0.0, 10.0, 51)).pairs
    # freud's distances have single precision: few pairs change the bin, and the sum cannot differ.
    difference = theirs.bin_counts / 2.0 - ours
    assert np.abs(difference).max() <= 1.0
    assert np.abs(np.cumsum(difference)).max() <= 1.0


def test_absent_grains_and_defaults(random: np.random.Generator) -> None:
    points = random.random((80, 2)) * [2.0, 1.0]
    gaps = np.insert(points, [0, 7], np.nan, axis=0)
    found, wanted = radial_distribution(gaps), radial_distribution(points)
    np.testing.assert_array_equal(found.values, wanted.values)
    assert found.edges[-1] == pytest.approx(0.5 * np.ptp(points[:, 1]))


def test_unfit_arguments_are_input_errors(random: np.random.Generator) -> None:
    points = random.random((30, 2))
    with pytest.raises(InputError, match="beyond the shorter side"):
        radial_distribution(points, np.array([0.0, 1.2]))
    with pytest.raises(InputError, match="increase"):
        radial_distribution(points, np.array([0.3, 0.2]))
    with pytest.raises(InputError, match=r"the box has the shape \(3,\)"):
        radial_distribution(hexagonal(4, 4), box=np.ones(3))
    with pytest.raises(InputError, match="outside of the box"):
        radial_distribution(points, box=np.array([[0.0, 0.0], [0.5, 0.5]]))
    with pytest.raises(InputError, match="at least 2"):
        radial_distribution(points[:1])
    with pytest.raises(InputError, match="interior cell"):
        bond_correlation(points[:3])


def test_bond_correlation_of_a_crystal_is_one() -> None:
    found = bond_correlation(hexagonal(15, 14), np.linspace(0.0, 5.0, 26))
    assert (found.pairs > 0).sum() > 10
    np.testing.assert_allclose(found.values[found.pairs > 0], 1.0, rtol=0.0, atol=1e-11)
    assert np.isnan(found.values[found.pairs == 0]).all()


def test_bond_correlation_is_that_of_brute_force(random: np.random.Generator) -> None:
    points = random.random((200, 2))
    edges = np.linspace(0.0, 0.5, 16)
    found = bond_correlation(points, edges)
    inside = voronoi_cells(points).interior
    order, gaps = local_psi6(points)[inside], distances(points[inside])
    i, j = np.triu_indices(len(order), 1)
    products = (order[i].conj() * order[j]).real
    wanted = [products[(gaps > lo) & (gaps <= hi)].mean() for lo, hi in itertools.pairwise(edges)]
    np.testing.assert_allclose(found.values, wanted, rtol=0.0, atol=1e-12)


def test_two_crystals_turned_by_half_a_period_are_anticorrelated() -> None:
    """Turned by 30 degrees, psi6 changes its sign: pairs across have the product -1."""
    left = hexagonal(12, 14)
    right = hexagonal(14, 12)[:, ::-1] + [14.0, 0.0]
    found = bond_correlation(np.concatenate([left, right]), np.array([0.5, 1.2, 13.0, 14.0]))
    assert found.values[0] > 0.8
    assert found.values[2] < -0.7


def test_over_the_frames_of_a_run(make_run: MakeRun, random: np.random.Generator) -> None:
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
