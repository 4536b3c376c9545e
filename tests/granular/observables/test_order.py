"""Order and motion in time."""

import math

import numpy as np
import pytest

from granular.observables import (
    bond_relaxation,
    lindemann_parameter,
    mean_square_displacement,
    non_affine_motion,
    non_affine_series,
    per_lag,
    voronoi_cells,
)
from granular.shared.errors import InputError

from .conftest import MakeRun, hexagonal, rotated


def walk(random: np.random.Generator, frames: int, step: float) -> np.ndarray:
    steps = step * random.normal(size=(frames, 500, 2))
    return np.asarray(hexagonal(25, 20)[None] + np.cumsum(steps, axis=0))


def test_random_walk(make_run: MakeRun, random: np.random.Generator) -> None:
    """<r^2> = 2 s^2 t, gamma = 2 s^2 t/a^2 of independent normal steps."""
    frames, lags = walk(random, 60, 0.01), np.array([1, 4, 16])
    np.testing.assert_allclose(mean_square_displacement(frames, lags), 2e-4 * lags, rtol=0.05)
    np.testing.assert_allclose(lindemann_parameter(frames, lags), 2e-4 * lags, rtol=0.08)
    run = make_run(0.006 * frames)
    found = per_lag(run, mean_square_displacement)
    assert found.attrs["units"] == "m^2"
    assert float(found[0]) == pytest.approx(0.006**2 * 2e-4, rel=0.05)
    assert float(found["lag"][0]) == 1.0
    assert float(per_lag(run, lindemann_parameter)[0]) == pytest.approx(2e-4, rel=0.08)


def test_waves_move_grains_and_not_neighbours() -> None:
    """A crystal that is carried along: the displacement grows, the Lindemann parameter is 0."""
    frames = hexagonal(10, 10)[None] + 0.1 * np.arange(6.0)[:, None, None]
    assert mean_square_displacement(frames, np.array([5]))[0] == pytest.approx(0.5)
    np.testing.assert_allclose(lindemann_parameter(frames), 0.0, atol=1e-20)
    np.testing.assert_allclose(bond_relaxation(frames), 1.0, rtol=1e-9)


def test_bond_orientation_of_a_turning_crystal(make_run: MakeRun) -> None:
    """cos(6 omega t)."""
    omega = 0.02
    frames = np.array([rotated(hexagonal(12, 12), omega * k) for k in range(20)])
    lags = np.array([1, 5, 19])
    np.testing.assert_allclose(bond_relaxation(frames, lags), np.cos(6.0 * omega * lags), atol=1e-9)
    assert float(per_lag(make_run(0.006 * frames), bond_relaxation)[0]) == pytest.approx(
        math.cos(6.0 * omega), abs=1e-9
    )


def test_strain_is_affine_and_a_hop_is_not(make_run: MakeRun) -> None:
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
    # What one of six neighbours does alone: the best strain takes a third of it.
    neighbours = np.flatnonzero(np.linalg.norm(points - points[hop], axis=1).round(6) == 1.0)
    np.testing.assert_allclose(
        jumped[neighbours], np.linalg.norm([0.3, 0.0]) ** 2 / 6.0 * (2.0 / 3.0), rtol=1e-6
    )
    series = non_affine_series(make_run(0.006 * np.array([points, points, strained])))
    assert np.isnan(series.values[0]).all()
    assert float(series[1].max()) == pytest.approx(0.0, abs=1e-20)
    assert float(series[2, neighbours[0]]) == pytest.approx(0.006**2 * jumped[neighbours[0]])


def test_wrong_lags_and_frames(make_run: MakeRun) -> None:
    frames = np.array([hexagonal(6, 6)] * 4)
    with pytest.raises(InputError, match="take 1 to 3 frames"):
        mean_square_displacement(frames, np.array([4]))
    with pytest.raises(InputError, match=r"\(f, n, 2\)"):
        lindemann_parameter(frames[0])
    with pytest.raises(InputError, match="periods"):
        lindemann_parameter(frames, periods=(0.0, 1.0))
    run = make_run(0.006 * frames)
    run.dataset["frame_time"] = ("frame", np.array([0.0, 1.0, 2.0, 9.0]))
    with pytest.raises(InputError, match="within one stage"):
        per_lag(run, mean_square_displacement)
