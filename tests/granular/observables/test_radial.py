"""g(r) and g6(r) against brute force, ideal arrangements and another library."""

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
    """Fraction of the pairs of uniform points in a x b that are nearer than r, by quadrature."""

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
