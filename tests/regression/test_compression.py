"""Piston force and mean distance at the end of de Paula's compression, for three initial packings.

The quick protocol relaxes for 5 s or, with 92 grains, 7 s, and then compresses at 33 mm/s to 20 D
sqrt(N/368).
"""

import math

import numpy as np
import pytest

from granular import Scene, Trajectory, mono_bed, simulate
from granular.observables import depaula_pair_distance

SEEDS = (1, 2, 3)


def compression(count: int, seed: int, **changes: object) -> Scene:
    relaxation = 0.5 * math.sqrt(368 / count)
    scene = mono_bed(count, speed=0.033, relaxation=relaxation, seed=seed)
    kinds = ("descend", "move")
    stages = [{**stage.to_plain(), "kind": kind} for stage, kind in zip(scene.protocol, kinds, strict=False)]
    return scene.replace(protocol=stages, **changes)


def forces(runs: list[Trajectory]) -> np.ndarray:
    return np.array([float(run.dataset["piston_force"][-1]) for run in runs])


def half_distances(runs: list[Trajectory]) -> np.ndarray:
    """Return half of the mean pair distance at the end, in D."""
    return np.array([depaula_pair_distance(run.dataset["position"].values[-1]) / 0.006 for run in runs])


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("dt", [pytest.param(5e-4, marks=pytest.mark.long), 1e-3])
def test_mean_pair_distance_of_92_grains_agrees_with_de_paula(dt: float) -> None:
    runs = [simulate(compression(92, seed), dt, progress=False) for seed in SEEDS]
    assert half_distances(runs).mean() == pytest.approx(5.33, rel=5e-3)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize(("count", "force", "distance"), [(368, 15.26, 10.90), (736, 23.23, 15.53)])
@pytest.mark.parametrize("dt", [2e-4, 1e-3])
@pytest.mark.long
def test_piston_force_and_pair_distance_agree_with_de_paula(
    count: int, force: float, distance: float, dt: float
) -> None:
    runs = [simulate(compression(count, seed), dt, progress=False) for seed in SEEDS]
    assert forces(runs).mean() == pytest.approx(force, rel=0.03)
    assert half_distances(runs).mean() == pytest.approx(distance, rel=5e-3)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("seeds", [SEEDS[:1], pytest.param(SEEDS, marks=pytest.mark.long)], ids=len)
def test_piston_force_of_368_grains_agrees_with_de_paula(seeds: tuple[int, ...]) -> None:
    """One packing, or the mean of three, is compressed with a step of 1 ms.

    Long tests also use smaller steps.
    """
    runs = [simulate(compression(368, seed), 1e-3, progress=False) for seed in seeds]
    assert forces(runs).mean() == pytest.approx(15.26, rel=0.03)
    assert half_distances(runs).mean() == pytest.approx(10.90, rel=5e-3)


@pytest.mark.long
def test_compression_with_drag_instead_of_friction_gives_a_piston_force_of_12_25_newtons() -> None:
    changes = {"effects.friction": None, "effects.drag": {"coefficient": 0.1}}
    runs = [simulate(compression(368, seed, **changes), progress=False) for seed in SEEDS]
    assert forces(runs).mean() == pytest.approx(12.25, abs=0.3)
