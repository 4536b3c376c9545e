"""Voronoi cells compared with geometry and brute-force computation; prescribed defects in a crystal."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from granular.observables import (
    cell_polygons,
    disclination_charges,
    dislocations,
    global_psi6,
    hexagon_regularity,
    local_psi6,
    per_frame,
    polygon_fractions,
    psi6,
    voronoi_cells,
)
from granular.shared.errors import InputError

from .conftest import MakeRun, brute_cells, displacement, hexagonal, polygon_area, rotated, side_lengths


@pytest.mark.parametrize("angle", [0.0, np.pi / 2.0])
@pytest.mark.parametrize("spacing", [1.0, 0.0137])
def test_voronoi_cells_of_a_hexagonal_lattice_are_regular_hexagons(angle: float, spacing: float) -> None:
    points = rotated(hexagonal(14, 12, spacing), angle) + 0.4
    cells = voronoi_cells(points)
    fractions = polygon_fractions(cells)
    assert fractions[:4] == (0.0, 1.0, 0.0, 0.0)
    assert fractions.cells > 80
    inside = cells.interior
    np.testing.assert_allclose(hexagon_regularity(cells)[inside], 1.0, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(cells.area[inside], np.sqrt(3.0) / 2.0 * spacing**2, rtol=1e-12)
    assert psi6(points) == pytest.approx(1.0, abs=1e-12)
    assert global_psi6(points) == pytest.approx(np.exp(6j * angle), abs=1e-12)


def test_interior_voronoi_cells_of_a_crystal_patch_exclude_the_outer_rows() -> None:
    """At zigzag sides, the open half hexagons are excluded too."""
    inside = voronoi_cells(hexagonal(6, 5)).interior.reshape(5, 6)
    wanted = np.zeros((5, 6), dtype=bool)
    wanted[1:4, 1:5] = True
    np.testing.assert_array_equal(inside, wanted)


@pytest.mark.parametrize("seed", range(4))
def test_voronoi_cells_of_random_points_agree_with_brute_force_computation(seed: int) -> None:
    points = np.random.default_rng(seed).random((70, 2)) * [2.0, 1.0]
    wanted = brute_cells(points)
    cells = voronoi_cells(points)
    inside = np.array([one.interior for one in wanted])
    np.testing.assert_array_equal(cells.interior, inside)
    assert inside.sum() > 25
    np.testing.assert_array_equal(
        cells.sides[inside], [len(one.neighbours) for one in wanted if one.interior]
    )
    areas = [polygon_area(one.corners) for one in wanted if one.interior]
    np.testing.assert_allclose(cells.area[inside], areas, rtol=1e-12)

    sides = np.array([len(one.neighbours) for one in wanted if one.interior])
    fractions = [np.mean(sides == k) for k in (5, 6, 7)]
    np.testing.assert_allclose(polygon_fractions(cells)[:3], fractions, rtol=1e-12)
    assert sum(polygon_fractions(cells)[:4]) == pytest.approx(1.0, abs=1e-12)

    hexagons = [one.corners for one in wanted if one.interior and len(one.neighbours) == 6]
    regular = [4.0 / np.sqrt(3.0) * polygon_area(one) / (side_lengths(one) ** 2).sum() for one in hexagons]
    found = hexagon_regularity(cells)
    np.testing.assert_allclose(found[np.isfinite(found)], regular, rtol=1e-12)
    assert (np.array(regular) < 1.0).all()

    order = []
    for grain in np.flatnonzero(inside):
        arms = points[wanted[grain].neighbours] - points[grain]
        order.append(np.exp(6j * np.arctan2(arms[:, 1], arms[:, 0])).mean())
    np.testing.assert_allclose(local_psi6(points)[inside], order, rtol=0.0, atol=1e-12)
    assert psi6(points) == pytest.approx(np.mean(np.abs(order)), abs=1e-12)


def test_polygons_of_voronoi_cells_have_the_computed_areas(random: np.random.Generator) -> None:
    cells = voronoi_cells(random.random((200, 2)))
    polygons = cell_polygons(cells)
    assert list(polygons) == np.flatnonzero(cells.interior).tolist()
    for grain, corners in polygons.items():
        assert len(corners) == cells.sides[grain]
        assert polygon_area(corners) == pytest.approx(cells.area[grain], rel=1e-10)
        assert (side_lengths(corners) ** 2).sum() == pytest.approx(cells.side_squares[grain], rel=1e-10)


def test_voronoi_cells_ignore_grains_that_have_left(random: np.random.Generator) -> None:
    points = random.random((150, 2))
    gaps = np.insert(points, [0, 40, 150], np.nan, axis=0)
    here = np.isfinite(gaps[:, 0])
    cells, wanted = voronoi_cells(gaps), voronoi_cells(points)
    np.testing.assert_array_equal(cells.sides[here], wanted.sides)
    np.testing.assert_array_equal(cells.interior[here], wanted.interior)
    assert not cells.interior[~here].any()
    assert (cells.sides[~here] == 0).all()
    assert psi6(gaps) == psi6(points)
    assert np.isnan(local_psi6(gaps)[~here]).all()


def test_voronoi_cells_of_a_square_lattice_have_four_sides() -> None:
    """Rounding does not turn a corner shared by four cells into an additional side."""
    x, y = np.meshgrid(np.arange(9), np.arange(8))
    points = rotated(np.stack([x.ravel(), y.ravel()], axis=1) * 0.1, 0.7)
    cells = voronoi_cells(points)
    assert (cells.sides[cells.interior] == 4).all()
    assert polygon_fractions(cells).others == 1.0
    assert psi6(points) == pytest.approx(1.0 * abs(np.exp(6j * np.pi * np.arange(4) / 2).mean()))


@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_a_single_row_or_fewer_than_three_grains_have_no_interior_voronoi_cells(count: int) -> None:
    points = np.stack([np.arange(float(count)), np.zeros(count)], axis=1)
    cells = voronoi_cells(points)
    assert not cells.interior.any()
    assert polygon_fractions(cells).cells == 0
    assert np.isnan(polygon_fractions(cells).hexagons)
    assert np.isnan(psi6(points))


def test_voronoi_cells_refuse_positions_of_wrong_shape() -> None:
    with pytest.raises(InputError, match=r"\(3, 3\)"):
        voronoi_cells(np.zeros((3, 3)))


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10**6), angle=st.sampled_from([0.0, np.pi / 2.0, np.pi]), scale=st.floats(1e-3, 1e3)
)
def test_bond_order_and_numbers_of_cell_sides_do_not_change_under_shift_scaling_and_quarter_turns(
    seed: int, angle: float, scale: float
) -> None:
    points = np.random.default_rng(seed).random((60, 2))
    moved = scale * (rotated(points, angle) + 0.3)
    assert psi6(moved) == pytest.approx(psi6(points), abs=1e-9)
    assert polygon_fractions(voronoi_cells(moved)) == polygon_fractions(voronoi_cells(points))


def test_voronoi_observables_of_a_run_equal_the_functions_for_single_frames(
    make_run: MakeRun, random: np.random.Generator
) -> None:
    frames = np.stack([0.006 * hexagonal(8, 8), 0.05 * random.random((64, 2))])
    frames[1, 3] = np.nan
    run = make_run(frames)
    fractions, cells = per_frame(run, "polygons"), per_frame(run, "interior_cells")
    assert fractions.dims == ("frame", "label")
    assert fractions.attrs["units"] == "1"
    np.testing.assert_array_equal(fractions["frame_time"], [0.0, 1.0])
    for k, frame in enumerate(frames):
        wanted = polygon_fractions(voronoi_cells(frame))
        found = [float(fractions.sel(label=name)[k]) for name in wanted._fields[:4]]
        assert (*found, float(cells[k])) == wanted
    np.testing.assert_array_equal(per_frame(run, "hexatic_order"), [psi6(one) for one in frames])
    regularity = per_frame(run, "regularity")
    regular = {name: regularity.sel(label=name) for name in ("mean", "deviation")}
    assert float(regular["mean"][0]) == pytest.approx(1.0, abs=1e-12)
    assert float(regular["deviation"][0]) == pytest.approx(0.0, abs=1e-12)
    values = hexagon_regularity(voronoi_cells(frames[1]))
    assert float(regular["mean"][1]) == pytest.approx(np.nanmean(values), rel=1e-12)


def with_dislocation(burgers: np.ndarray, size: int = 21) -> np.ndarray:
    """Return a hexagonal lattice of spacing 1 with an edge dislocation near its centre."""
    lattice = hexagonal(size, size)
    # The core lies between two rows, above the middle of a bond along b.
    middle = lattice[(size // 2) * size + size // 2]
    core = middle + 0.5 * burgers + 0.5 * np.sqrt(3.0) / 2.0 * np.array([-burgers[1], burgers[0]])
    return lattice + displacement(lattice, core, burgers)


def central(points: np.ndarray, reach: float = 5.0) -> np.ndarray:
    return np.linalg.norm(points - points.mean(axis=0), axis=1) < reach


@pytest.mark.parametrize("sixth", range(6))
def test_burgers_vector_of_a_prescribed_edge_dislocation_is_recovered(sixth: int) -> None:
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


def test_a_perfect_crystal_has_no_defects(make_run: MakeRun) -> None:
    points = hexagonal(10, 10)
    cells = voronoi_cells(points)
    assert not disclination_charges(cells).any()
    assert dislocations(points, cells).burgers.shape == (0, 2)
    counts = per_frame(make_run(0.006 * points[None]), "defects")
    assert counts["label"].values.tolist() == ["disclinations", "dislocations", "unpaired"]
    assert counts.values.tolist() == [[0, 0, 0]]


@pytest.mark.parametrize(("sectors", "charge"), [(5, 1), (7, -1)])
def test_a_crystal_of_five_or_seven_60_degree_sectors_has_one_disclination_of_charge_1_or_minus_1(
    sectors: int, charge: int
) -> None:
    """The sectors are compressed or stretched to close the circle."""
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


def test_each_dislocation_pairs_a_five_and_a_seven_sided_cell_and_no_further_pair_is_possible(
    random: np.random.Generator,
) -> None:
    points = random.random((400, 2))
    cells = voronoi_cells(points)
    found = dislocations(points, cells)
    bonds = {frozenset(one) for one in cells.neighbours.tolist()}
    assert all(frozenset(one) in bonds for one in found.pairs.tolist())
    assert len(np.unique(found.pairs)) == found.pairs.size
    assert (cells.sides[found.pairs] == [5, 7]).all()
    assert cells.interior[found.pairs].all()
    # No pair can be added: no unpaired pentagon has an unpaired heptagon as neighbour.
    charges = disclination_charges(cells)
    charges[found.pairs.ravel()] = 0
    left = charges[cells.neighbours]
    assert not ((left[:, 0] * left[:, 1] == -1) & (np.abs(left) == 1).all(axis=1)).any()
    np.testing.assert_allclose(
        np.einsum("ij,ij->i", found.burgers, points[found.pairs[:, 1]] - points[found.pairs[:, 0]]),
        0.0,
        atol=1e-12,
    )


def test_defects_are_counted_in_every_frame_of_a_run(make_run: MakeRun, random: np.random.Generator) -> None:
    frames = random.random((2, 100, 2)) * 0.06
    counts = per_frame(make_run(frames), "defects")
    for k, frame in enumerate(frames):
        cells = voronoi_cells(frame)
        irregular = np.count_nonzero(cells.sides[cells.interior] != 6)
        pairs = len(dislocations(frame, cells).pairs)
        assert int(counts.sel(label="disclinations")[k]) == irregular
        assert int(counts.sel(label="unpaired")[k]) == irregular - 2 * pairs
