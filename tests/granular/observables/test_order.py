"""Translational order, fluctuations in blocks, and order and motion in time."""

from __future__ import annotations

import math

import numpy as np
import pytest

from granular.observables import (
    block_susceptibilities,
    bond_relaxation,
    hexatic_susceptibility,
    lindemann_parameter,
    local_psi6,
    mean_square_displacement,
    non_affine_motion,
    non_affine_series,
    non_gaussian_parameter,
    per_distance,
    per_lag,
    reciprocal_lattice_vector,
    structure_factor,
    translational_correlation,
    translational_order,
    voronoi_cells,
)
from granular.shared.errors import InputError

from .conftest import MakeRun, hexagonal, rotated


def test_structure_factor_of_a_crystal_and_of_no_order(random: np.random.Generator) -> None:
    points = hexagonal(12, 14)
    vectors = 2.0 * math.pi * np.array([[0.0, 2.0 / math.sqrt(3.0)], [1.0, 1.0 / math.sqrt(3.0)]])
    np.testing.assert_allclose(structure_factor(points, vectors), len(points), rtol=1e-10)
    waves = 20.0 + 80.0 * random.random((400, 2))
    assert structure_factor(random.random((500, 2)), waves).mean() == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.2])
def test_lattice_vector_is_found_whatever_the_orientation(angle: float) -> None:
    spacing = 0.0123
    points = rotated(hexagonal(24, 20, spacing), angle)
    vector = reciprocal_lattice_vector(points)
    assert np.linalg.norm(vector) == pytest.approx(4.0 * math.pi / math.sqrt(3.0) / spacing, 1e-3)
    assert translational_order(points) > 0.999
    assert translational_order(points, rotated(vector[None], 0.2)[0]) < 0.1
    with pytest.raises(InputError, match="wave vector has the shape"):
        translational_order(points, np.ones(3))
    with pytest.raises(InputError, match="no grain is present"):
        translational_correlation(points[:0], np.array([0.0, 1.0]), vector)


def test_translational_order_falls_by_debye_and_waller(random: np.random.Generator) -> None:
    """exp(-G^2 s^2/2) for independent displacements of s along each axis; its square for pairs."""
    points, s = hexagonal(40, 40), 0.04
    jittered = points + s * random.normal(size=points.shape)
    wanted = math.exp(-((4.0 * math.pi / math.sqrt(3.0) * s) ** 2) / 2.0)
    assert translational_order(jittered) == pytest.approx(wanted, rel=0.01)
    found = translational_correlation(jittered, np.array([0.5, 5.0, 15.0]))
    np.testing.assert_allclose(found.values, wanted**2, rtol=0.01)


def test_translational_correlation_of_no_order(make_run: MakeRun, random: np.random.Generator) -> None:
    frames = random.random((3, 400, 2)) * 0.1
    found = per_distance(make_run(frames), translational_correlation, np.array([0.02, 0.03, 0.05]))
    assert found.dims == ("distance",)
    assert float(abs(found).max()) < 0.1


def test_blocks_of_independent_grains_fluctuate_alike(random: np.random.Generator) -> None:
    """As many independent phases: chi6 is about the same in blocks of any size."""
    frames = random.random((60, 400, 2))
    found = block_susceptibilities(frames, (1, 2, 4))
    orders = []
    for one in frames:
        cells = voronoi_cells(one)
        orders.append(local_psi6(one, cells)[cells.interior])
    integer = hexatic_susceptibility(
        np.array([one.mean() for one in orders]), np.array([len(one) for one in orders])
    )
    assert found[0] == pytest.approx(integer, rel=1e-12)
    assert found[2] == pytest.approx(found[1], rel=0.3)
    with pytest.raises(InputError, match="from 1 up"):
        block_susceptibilities(frames, (0,))
    with pytest.raises(InputError, match="0 frames"):
        block_susceptibilities(frames[:0])
    assert np.isnan(block_susceptibilities(frames[:, :0])).all()


def walk(random: np.random.Generator, frames: int, step: float) -> np.ndarray:
    steps = step * random.normal(size=(frames, 500, 2))
    return np.asarray(hexagonal(25, 20)[None] + np.cumsum(steps, axis=0))


def test_random_walk(make_run: MakeRun, random: np.random.Generator) -> None:
    """<r^2> = 2 s^2 t, alpha_2 = 0 and gamma = 2 s^2 t/a^2 of independent normal steps."""
    frames, lags = walk(random, 60, 0.01), np.array([1, 4, 16])
    np.testing.assert_allclose(mean_square_displacement(frames, lags), 2e-4 * lags, rtol=0.05)
    np.testing.assert_allclose(non_gaussian_parameter(frames, lags), 0.0, atol=0.05)
    np.testing.assert_allclose(lindemann_parameter(frames, lags), 2e-4 * lags, rtol=0.08)
    run = make_run(0.006 * frames)
    found = per_lag(run, mean_square_displacement)
    assert found.attrs["units"] == "m^2"
    assert float(found[0]) == pytest.approx(0.006**2 * 2e-4, rel=0.05)
    assert float(found["lag"][0]) == 1.0
    assert abs(float(per_lag(run, non_gaussian_parameter)[0])) < 0.05
    assert float(per_lag(run, lindemann_parameter)[0]) == pytest.approx(2e-4, rel=0.08)


def test_waves_move_grains_and_not_neighbours() -> None:
    """A crystal that is carried along: the displacement grows, the Lindemann parameter is 0."""
    frames = hexagonal(10, 10)[None] + 0.1 * np.arange(6.0)[:, None, None]
    assert mean_square_displacement(frames, np.array([5]))[0] == pytest.approx(0.5)
    np.testing.assert_allclose(lindemann_parameter(frames), 0.0, atol=1e-20)
    np.testing.assert_allclose(bond_relaxation(frames), 1.0, rtol=1e-9)


def test_two_sorts_of_walkers_are_not_gaussian(random: np.random.Generator) -> None:
    """Half of the grains still: <r^4>/(2 <r^2>^2) = 2."""
    frames = walk(random, 40, 0.01)
    frames[:, ::2] = frames[0, ::2]
    assert non_gaussian_parameter(frames, np.array([1]))[0] == pytest.approx(1.0, abs=0.1)


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
