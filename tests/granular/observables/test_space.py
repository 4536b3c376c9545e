"""Packing fraction, distances and local area fraction."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from granular.observables import (
    area_fraction_by_depth,
    area_fraction_profile,
    depaula_pair_distance,
    least_piston_distance,
    mean_pair_distance,
    packing_fraction,
    packing_fraction_series,
    per_frame,
)
from granular.shared.errors import InputError

from .conftest import TWO_SPECIES, MakeRun


def test_packing_fractions_agree_with_published_values() -> None:
    """They are 0.241 for 368 grains of 6 mm in 60 D x 20 D, and 0.34 for 400 grains of 5 mm in 66 D x
    14 D.
    """
    assert packing_fraction(np.full(368, 6e-3), 0.36, 0.12) == pytest.approx(0.241, abs=5e-4)
    assert packing_fraction(np.full(400, 5e-3), 0.33, 0.07) == pytest.approx(0.34, abs=5e-4)


def test_packing_fraction_of_a_run_uses_the_present_piston_height_and_number_of_grains(
    make_run: MakeRun, random: np.random.Generator
) -> None:
    frames = random.random((3, 4, 2)) * 0.1
    frames[2, :2] = np.nan
    time = np.array([0.0, 0.5, 1.0, 1.9, 2.0])
    heights = np.array([0.36, 0.36, 0.18, 0.18, 0.09])
    columns = {"time": time, "piston_height": heights, "grain_count": np.array([4, 4, 4, 4, 2])}
    run = make_run(frames, columns=columns)
    covered = np.pi * 0.003**2 * np.array([4, 4, 4, 4, 2])
    np.testing.assert_allclose(packing_fraction_series(run), covered / (0.36 * heights), rtol=1e-12)


@pytest.mark.parametrize("count", [2, 3, 50, 2100])
def test_mean_pair_distance_is_the_mean_over_all_pairs(count: int, random: np.random.Generator) -> None:
    points = random.random((count, 2))
    gaps = np.sqrt(((points[:, None] - points[None]) ** 2).sum(axis=2))
    wanted = gaps.sum() / (count * (count - 1))
    assert mean_pair_distance(points) == pytest.approx(wanted, rel=1e-12)
    assert depaula_pair_distance(points) == pytest.approx(wanted / 2.0, rel=1e-12)


def test_distances_are_nan_without_grains(make_run: MakeRun) -> None:
    frame = np.array([[0.0, 0.0], [np.nan, np.nan], [0.03, 0.04]])
    assert mean_pair_distance(frame) == pytest.approx(0.05)
    assert np.isnan(mean_pair_distance(frame[:2]))
    series = per_frame(make_run(frame[None]), "mean_distance")
    assert series.attrs["units"] == "m"
    assert float(series[0]) == pytest.approx(0.05)


def test_minimum_distance_to_the_piston_is_computed_for_each_species(make_run: MakeRun) -> None:
    frames = np.array([[[0.1, 0.10], [0.2, 0.15], [0.1, 0.20], [np.nan, np.nan]]])
    run = make_run(frames, {"grains.species": TWO_SPECIES}, heights=np.array([0.21]))
    owner = run.dataset["species"].values
    found = per_frame(run, "species_piston_distance")
    for k, name in enumerate(("big", "small")):
        highest = np.nanmax(frames[0, owner == k, 1])
        assert float(found.sel(label=name)[0]) == pytest.approx(0.21 - highest)
    assert float(found.min()) == pytest.approx(0.01)
    assert np.isnan(least_piston_distance(np.full((2, 2), np.nan), 1.0))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), cuts=st.lists(st.floats(0.05, 0.95), min_size=0, max_size=12, unique=True))
def test_local_area_fractions_add_up_to_the_packing_fraction(seed: int, cuts: list[float]) -> None:
    """For any division into strips, the covered areas add up to the areas of the discs."""
    random = np.random.default_rng(seed)
    diameters = random.uniform(0.01, 0.1, 30)
    points = random.uniform(0.05, 0.95, (30, 2))
    edges = np.sort([0.0, 1.0, *cuts])
    if np.diff(edges).min() < 1e-6:
        return
    profile = area_fraction_profile(points, diameters, 1.0, edges)
    assert (profile >= 0.0).all()
    assert profile @ np.diff(edges) == pytest.approx(float(packing_fraction(diameters, 1.0, 1.0)), rel=1e-12)


def test_local_area_fraction_of_a_single_disc_is_the_integral_of_its_chords() -> None:
    radius, centre = 0.3, 0.5
    edges = np.array([0.1, 0.25, 0.4, 0.5, 0.77, 0.9])
    profile = area_fraction_profile(np.array([[0.4, centre]]), np.array([0.6]), 2.0, edges)
    nodes, weights = np.polynomial.legendre.leggauss(30)
    for k, (low, high) in enumerate(itertools.pairwise(edges)):
        # Chord 2 r cos(t) at the height r sin(t), smooth in t.
        a, b = np.arcsin(np.clip((np.array([low, high]) - centre) / radius, -1.0, 1.0))
        angle = 0.5 * (a + b) + 0.5 * (b - a) * nodes
        area = 0.5 * (b - a) * weights @ (2.0 * radius**2 * np.cos(angle) ** 2)
        assert profile[k] * 2.0 * (high - low) == pytest.approx(area, rel=1e-12)
    # A strip that ends at the centre of a disc covers half the disc.
    half = area_fraction_profile(np.array([[0.4, 0.5]]), np.array([0.6]), 1.0, np.array([0.5, 0.8]))
    assert half[0] * 0.3 == pytest.approx(np.pi * 0.09 / 2.0, rel=1e-13)


def test_local_area_fraction_is_a_function_of_depth_below_the_piston(make_run: MakeRun) -> None:
    """The first strip starts at the piston, and the last ends at the bottom.

    Values for depths below the bottom are NaN.
    """
    frames = np.array([[[0.1, 0.05], [0.2, 0.020]], [[0.1, 0.017], [0.2, 0.010]]])
    run = make_run(frames, heights=np.array([0.06, 0.026]))
    profile = area_fraction_by_depth(run, thickness=0.012)
    assert profile["depth"].values == pytest.approx([0.006, 0.018, 0.030, 0.042, 0.054])
    disc = np.pi * 0.003**2 / (0.36 * 0.012)
    # Heights 0.048 to 0.06 contain the first disc except its part below 0.048.
    assert float(profile[0, :2].sum()) == pytest.approx(disc, rel=1e-12)
    assert float(profile[0, 2:].sum()) == pytest.approx(disc, rel=1e-12)
    # In the second frame the strips are 0.014 to 0.026, 0.002 to 0.014 and 0 to 0.002.
    assert float(profile[1, 2]) == 0.0
    assert float(profile[1, :2].sum()) == pytest.approx(2.0 * disc, rel=1e-12)
    assert np.isnan(profile[1, 3:]).all()


def test_packing_and_distance_functions_refuse_invalid_arguments(make_run: MakeRun) -> None:
    points = np.zeros((2, 2))
    with pytest.raises(InputError, match="one value per grain"):
        area_fraction_profile(points, np.ones(3), 1.0, np.array([0.0, 1.0]))
    with pytest.raises(InputError, match="increasing"):
        area_fraction_profile(points, np.ones(2), 1.0, np.array([1.0, 0.0]))
    with pytest.raises(InputError, match="above 0 m"):
        packing_fraction(np.ones(2), 1.0, 0.0)
    with pytest.raises(InputError, match="thickness"):
        area_fraction_by_depth(make_run(points[None]), thickness=-1.0)
    with pytest.raises(InputError, match=r"\(4,\)"):
        mean_pair_distance(np.zeros(4))
