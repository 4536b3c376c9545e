"""The list of near pairs contains every pair within its distance, for any positions and cell."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from granular.compiled import entry
from granular.pairs import near_list
from granular.pairs.direct_sum import pad_coordinates, pad_values
from granular.pairs.near_list import BUILDS, NearList, allocate_near_list

refresh_near_list = entry(near_list.refresh_near_list)

Pair = tuple[int, int, float, float]


def listed_pairs(near: NearList, x: np.ndarray, y: np.ndarray, count: int, reach: float) -> set[Pair]:
    """Return the listed pairs within a distance, each with the shift of its periodic image.

    Assert that the pairs are in order and that none is repeated.
    """
    result: set[Pair] = set()
    for i in range(count):
        before: tuple[float, ...] = (-1.0,)
        for k in range(near.starts[i], near.starts[i + 1]):
            j, shift = int(near.partners[k]), np.zeros(2) if near.shifts is None else near.shifts[:, k]
            assert before < (j, shift[1], shift[0])
            before = (j, shift[1], shift[0])
            if np.hypot(x[i] - x[j] + shift[0], y[i] - y[j] + shift[1]) < reach:
                result.add((i, j, *np.round(shift, 9)))
    return result


@settings(max_examples=60, deadline=None)
@given(
    count=st.integers(0, 200),
    seed=st.integers(0, 10**6),
    reach=st.floats(0.1, 3.0),
    width=st.floats(0.5, 50.0),
)
def test_list_of_near_pairs_agrees_with_a_tree_search(
    count: int, seed: int, reach: float, width: float
) -> None:
    place = np.random.default_rng(seed).uniform(0.0, 1.0, (count, 2)) * [width, 12.0]
    near = allocate_near_list(count, reach)
    near = near._replace(partners=np.zeros(max(1, count * count), dtype=np.uint32))
    x, y = pad_coordinates(place)
    assert refresh_near_list(near, x, y, count)
    wanted = cKDTree(place).query_pairs(reach, output_type="set") if count else set()
    assert {pair[:2] for pair in listed_pairs(near, x, y, count, reach)} == wanted


def images_within(place: np.ndarray, periods: tuple[float, float], reach: float) -> set[Pair]:
    """Return pairs and shifts of all images within a distance, by brute force.

    Of a grain's own images, only half are included.
    """
    result, sides = set(), np.array(periods)
    most = int(np.ceil(reach / sides.min())) + 1
    for i in range(len(place)):
        for j in range(i, len(place)):
            nearest = -sides * np.rint((place[i] - place[j]) / sides)
            for across in range(-most, most + 1):
                for up in range(-most, most + 1):
                    shift = nearest + sides * [across, up]
                    opposite = i == j and (up, across) <= (0, 0)
                    if np.hypot(*(place[i] - place[j] + shift)) < reach and not opposite:
                        result.add((i, j, *np.round(shift, 9)))
    return result


@pytest.mark.parametrize("seed", range(12))
def test_list_of_near_pairs_contains_all_periodic_images_while_grains_move(seed: int) -> None:
    """A distance beyond the cell includes several images of a grain. Grains may be many periods apart."""
    random = np.random.default_rng(seed)
    count, periods = int(random.integers(2, 30)), tuple(random.uniform(2.0, 9.0, 2))
    reach = float(random.uniform(0.4, 1.5 * max(periods)))
    place = random.uniform(-3.0, 3.0, (count, 2)) * periods
    near = allocate_near_list(count, reach, periods=periods)
    near = near._replace(partners=np.zeros(99999, dtype=np.uint32), shifts=np.zeros((2, 99999)))
    for move in (0.0, 0.03, 0.03, 0.2):
        place = place + random.uniform(-move, move, place.shape)
        x, y = pad_coordinates(place)
        assert refresh_near_list(near, x, y, count)
        assert listed_pairs(near, x, y, count, reach) == images_within(place, periods, reach)


def test_list_of_near_pairs_is_rebuilt_after_a_grain_moved_by_half_the_list_margin() -> None:
    near = allocate_near_list(2, 1.0, skin=0.2)
    builds = []
    for place in (1.25, 1.16, 1.149, 1.051, 1.048):
        refresh_near_list(near, np.array([0.0, place]), np.zeros(2), 2)
        builds.append((int(near.memory[BUILDS]), int(near.starts[2])))
    assert builds == [(1, 0), (1, 0), (2, 1), (2, 1), (3, 1)]


@pytest.mark.parametrize("far", [1.0, 1e4, 1e12, 1e15, 1e100])
def test_near_pairs_are_listed_in_cells_far_larger_than_the_grains(far: float) -> None:
    """A division of the cell into squares of the grains' size would overflow integers."""
    random = np.random.default_rng(3)
    places = far * random.integers(1, 5, (2, 10)) + random.uniform(0.0, 0.8, (2, 10))
    near = allocate_near_list(10, 1.0)
    assert refresh_near_list(near, *places, 10)
    gap = np.hypot(*(places[:, :, None] - places[:, None, :]))
    assert {pair[:2] for pair in listed_pairs(near, *places, 10, 1.0)} == {
        (i, j) for i in range(10) for j in range(i + 1, 10) if gap[i, j] < 1.0
    }


@pytest.mark.parametrize("slot", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("periods", [None, (4.0, 4.0)])
def test_list_of_near_pairs_is_not_built_while_a_position_is_nan_or_infinite(
    slot: float, periods: tuple[float, float] | None
) -> None:
    near = allocate_near_list(3, 1.0, periods=periods)
    assert not refresh_near_list(near, np.array([0.0, slot, 2.0]), np.zeros(3), 3)
    assert not refresh_near_list(near, np.array([0.0, slot, 2.0]), np.zeros(3), 3)
    assert refresh_near_list(near, np.array([0.0, 0.5, 2.0]), np.zeros(3), 3)
    assert near.starts[3] == 1


def test_more_near_pairs_than_the_list_can_store_raise_an_error() -> None:
    near = allocate_near_list(40, 1.0)._replace(partners=np.zeros(40 * 39 // 2 - 1, dtype=np.uint32))
    assert not refresh_near_list(near, *np.zeros((2, 40)), 40)
    assert not refresh_near_list(near, *np.zeros((2, 40)), 40)


def test_list_of_near_pairs_contains_all_small_grains_that_overlap_a_big_one() -> None:
    """Hundreds of small grains are closer together than the diameter of the big grain, but few pairs
    overlap.
    """
    place = 0.11 * np.stack(np.meshgrid(np.arange(20), np.arange(20)), axis=-1).reshape(-1, 2)
    radius = np.full(400, 0.056)
    radius[0] = 0.5
    near = allocate_near_list(400, 1.0, skin=0.01, radius=pad_values(radius))
    x, y = pad_coordinates(place)
    assert refresh_near_list(near, x, y, 400)
    wanted = {
        (i, j)
        for i, j in cKDTree(place).query_pairs(1.0, output_type="set")
        if np.hypot(*(place[i] - place[j])) < radius[i] + radius[j]
    }
    found = {pair[:2] for pair in listed_pairs(near, x, y, 400, 1.0)}
    assert {(i, j) for i, j in found if np.hypot(*(place[i] - place[j])) < radius[i] + radius[j]} == wanted
