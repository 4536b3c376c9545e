"""Observables in a periodic cell do not depend on which image of a grain is stored."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from granular import Scene, evaluate, scene_text
from granular.observables import (
    bond_relaxation,
    force_distribution,
    frame_at,
    grain_pressures,
    lindemann_parameter,
    non_affine_series,
    per_frame,
    per_lag,
    track_defects,
)
from granular.render.movie import interpolate_frames_at_times
from granular.run.trajectory import Trajectory

from .conftest import MakeRun

SPACING, COLUMNS, ROWS = 0.012, 12, 14
WIDTH, HEIGHT = COLUMNS * SPACING, ROWS * SPACING * np.sqrt(0.75)


def scene(count: int, width: float = WIDTH, height: float = HEIGHT) -> Scene:
    return Scene.from_plain(
        {
            "grains": {"count": count, "species": [{"diameter": "6 mm"}]},
            "cell": {"width": width, "height": height, "sides": "periodic"},
            "effects": {"dipole": True},
            "arrangement": {"jitter": 0.0},
            "protocol": [{"kind": "hold", "name": "rest"}],
        }
    )


def make_periodic_run(make_run: MakeRun, frames: np.ndarray, velocities: Any = None) -> Trajectory:
    run = make_run(frames, {"arrangement.height": "0.3 m"}, velocities=velocities)
    return dataclasses.replace(run, scene=scene(frames.shape[1]))


def walk() -> np.ndarray:
    """Return frames of a fluctuating, drifting crystal with one grain removed, so that it has defects."""
    sites = scene(COLUMNS * ROWS).initial_positions_and_velocities()[0]
    steps = 0.08 * SPACING * np.random.default_rng(1).normal(size=(4, *sites.shape))
    return np.delete(sites + steps.cumsum(axis=0) + 0.004, 90, axis=1)


def defect_places(run: Trajectory) -> np.ndarray:
    return np.asarray(track_defects(run, minimum_frames=1)["position"].values)


def forces(run: Trajectory) -> np.ndarray:
    return np.concatenate([one.counts for one in force_distribution(frame_at(run)).values()])


def lindemann(run: Trajectory) -> np.ndarray:
    return per_lag(run, lindemann_parameter).values


def relaxation(run: Trajectory) -> np.ndarray:
    return per_lag(run, bond_relaxation).values


def stress(run: Trajectory) -> np.ndarray:
    return per_frame(run, "grain_stress").values


@pytest.mark.parametrize("measure", [lindemann, relaxation, non_affine_series, stress, defect_places, forces])
def test_observables_do_not_depend_on_the_image_of_a_grain(
    make_run: MakeRun, measure: Callable[[Trajectory], Any]
) -> None:
    """After long diffusion, the unwrapped positions of neighbours are far apart."""
    frames = walk()
    turns = np.random.default_rng(2).integers(-3, 4, frames.shape[1:])
    wanted = measure(make_periodic_run(make_run, frames))
    found = measure(make_periodic_run(make_run, frames + turns * [WIDTH, HEIGHT]))
    np.testing.assert_allclose(found, wanted, rtol=1e-8, atol=1e-12)
    assert np.isfinite(np.asarray(wanted, dtype=float)).any()


@pytest.mark.long
@pytest.mark.parametrize(("columns", "short"), [(12, 0.107), (64, 0.020)])
def test_pressure_from_nearest_images_is_too_low_by_a_known_fraction(columns: int, short: float) -> None:
    """The exact pressure is 3/2 of the energy per area, as for any pair energy r^-3 in two dimensions."""
    width = columns * 2.4 * 0.006
    still = scene(columns**2, width, width * np.sqrt(0.75)).replace(**{"pairs.method": "mesh"})
    places = still.initial_positions_and_velocities()[0]
    wanted = 1.5 * evaluate(still, places).potential_energy / np.prod(still.cell.periods)
    found = np.nanmean(grain_pressures(still, places))
    assert 1.0 - found / wanted == pytest.approx(short, abs=1e-3)


def test_movie_shows_a_grain_that_crosses_a_periodic_side_without_a_jump(make_run: MakeRun) -> None:
    frames = np.array([[[0.99 * WIDTH, 0.5 * HEIGHT]], [[1.01 * WIDTH, 0.5 * HEIGHT]]])
    speed = np.broadcast_to([0.02 * WIDTH, 0.0], frames.shape)
    run = make_periodic_run(make_run, frames, speed)
    place = [
        one.positions[0, 0] / WIDTH
        for one in interpolate_frames_at_times(run, [0, 1], np.array([0.25, 0.75]))
    ]
    np.testing.assert_allclose(place, [0.995, 0.005], atol=1e-12)


def test_packing_fraction_in_a_periodic_cell_is_relative_to_the_area_of_the_cell(make_run: MakeRun) -> None:
    run = make_periodic_run(make_run, walk())
    found = per_frame(run, "packing").values
    covered = (COLUMNS * ROWS - 1) * np.pi / 4.0 * 0.006**2
    np.testing.assert_allclose(found, covered / (WIDTH * HEIGHT))


def test_print_out_of_a_scene_mentions_its_periodic_sides() -> None:
    assert "126 mm high (21 D), periodic, packing" in scene_text(
        scene(24).replace(**{"cell.height": "126 mm"})
    )
    assert "mm high, periodic" in repr(scene(24))
