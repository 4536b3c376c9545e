"""Defects that were put into a crystal are found again."""

import numpy as np
import pytest

from granular.observables import disclination_charges, dislocations, per_frame, voronoi_cells

from .conftest import MakeRun, hexagonal, rotated


def with_dislocation(burgers: np.ndarray, size: int = 21) -> np.ndarray:
    """A hexagonal lattice of spacing 1 with an edge dislocation near its middle."""
    lattice = hexagonal(size, size)
    angle = np.arctan2(burgers[1], burgers[0])
    # The core stands between two rows, above the middle of a bond along b.
    middle = hexagonal(size, size)[(size // 2) * size + size // 2]
    start = middle + 0.5 * burgers + 0.5 * np.sqrt(3.0) / 2.0 * np.array([-burgers[1], burgers[0]])
    x, y = rotated(lattice - start, -angle).T
    r2 = x**2 + y**2
    nu = 1.0 / 3.0
    turn = 1.0 / (2.0 * np.pi)
    ux = turn * (np.arctan2(y, x) + x * y / (2.0 * (1.0 - nu) * r2))
    uy = -turn * (
        (1.0 - 2.0 * nu) / (4.0 * (1.0 - nu)) * np.log(r2) + (x**2 - y**2) / (4.0 * (1.0 - nu) * r2)
    )
    return lattice + rotated(np.stack([ux, uy], axis=1), angle)


def central(points: np.ndarray, reach: float = 5.0) -> np.ndarray:
    return np.linalg.norm(points - points.mean(axis=0), axis=1) < reach


@pytest.mark.parametrize("sixth", range(6))
def test_burgers_vector_of_an_edge_dislocation(sixth: int) -> None:
    angle = sixth * np.pi / 3.0
    burgers = np.array([np.cos(angle), np.sin(angle)])
    points = with_dislocation(burgers)
    found = dislocations(points)
    near = np.linalg.norm(found.positions - points.mean(axis=0), axis=1) < 5.0
    assert near.sum() == 1
    assert np.linalg.norm(found.burgers[near][0] - burgers) < 0.1
    charges = disclination_charges(voronoi_cells(points))
    assert sorted(charges[central(points)][charges[central(points)] != 0]) == [-1, 1]
    # The extra half row, and the pentagon, lie to the left of b.
    five, seven = points[found.pairs[near][0]]
    assert (five - seven) @ np.array([-burgers[1], burgers[0]]) > 0.8


def test_crystal_has_no_defects(make_run: MakeRun) -> None:
    points = hexagonal(10, 10)
    cells = voronoi_cells(points)
    assert not disclination_charges(cells).any()
    assert dislocations(points, cells).burgers.shape == (0, 2)
    counts = per_frame(make_run(0.006 * points[None]), "defects")
    assert counts["label"].values.tolist() == ["disclinations", "dislocations", "unpaired"]
    assert counts.values.tolist() == [[0, 0, 0]]


@pytest.mark.parametrize(("sectors", "charge"), [(5, 1), (7, -1)])
def test_wedge_disclination(sectors: int, charge: int) -> None:
    """Sectors of 60 degrees, pressed or drawn to close the circle, leave one disclination."""
    patch = hexagonal(41, 41)
    patch = patch - patch[20 * 41 + 20]
    angle = np.mod(np.arctan2(patch[:, 1], patch[:, 0]), 2.0 * np.pi)
    radius = np.linalg.norm(patch, axis=1)
    wedge = (radius > 0.5) & (radius < 12.0) & (angle < np.pi / 3.0 - 1e-9)
    turns = 2.0 * np.pi * np.arange(sectors) / sectors
    around = (angle[wedge] * 6.0 / sectors)[None] + turns[:, None]
    arms = np.stack([np.cos(around), np.sin(around)], axis=-1) * radius[wedge][None, :, None]
    points = np.concatenate([np.zeros((1, 2)), arms.reshape(-1, 2)])
    cells = voronoi_cells(points)
    inner = np.linalg.norm(points, axis=1) < 6.0
    charges = disclination_charges(cells)
    assert charges[0] == charge
    assert not charges[inner][1:].any()
    assert not np.isin(0, dislocations(points, cells).pairs)


def test_pairs_are_disjoint_neighbours_and_as_many_as_can_be(random: np.random.Generator) -> None:
    points = random.random((400, 2))
    cells = voronoi_cells(points)
    found = dislocations(points, cells)
    bonds = {frozenset(one) for one in cells.neighbours.tolist()}
    assert all(frozenset(one) in bonds for one in found.pairs.tolist())
    assert len(np.unique(found.pairs)) == found.pairs.size
    assert (cells.sides[found.pairs] == [5, 7]).all()
    assert cells.interior[found.pairs].all()
    # No pair can be added: no pentagon that is left has a heptagon that is left for a neighbour.
    charges = disclination_charges(cells)
    charges[found.pairs.ravel()] = 0
    left = charges[cells.neighbours]
    assert not ((left[:, 0] * left[:, 1] == -1) & (np.abs(left) == 1).all(axis=1)).any()
    np.testing.assert_allclose(
        np.einsum("ij,ij->i", found.burgers, points[found.pairs[:, 1]] - points[found.pairs[:, 0]]),
        0.0,
        atol=1e-12,
    )


def test_counts_of_a_run(make_run: MakeRun, random: np.random.Generator) -> None:
    frames = random.random((2, 100, 2)) * 0.06
    counts = per_frame(make_run(frames), "defects")
    for k, frame in enumerate(frames):
        cells = voronoi_cells(frame)
        irregular = np.count_nonzero(cells.sides[cells.interior] != 6)
        pairs = len(dislocations(frame, cells).pairs)
        assert int(counts.sel(label="disclinations")[k]) == irregular
        assert int(counts.sel(label="unpaired")[k]) == irregular - 2 * pairs
