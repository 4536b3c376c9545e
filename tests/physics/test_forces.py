"""Force of the packaged bed as minus the gradient of its energy, and the published scales."""

import math
from typing import Any

import numpy as np
import pytest

from granular import Scene, evaluate, load_scene
from tests.modes import quick_in_plain_python

MIXTURE = [
    {"name": "big", "diameter": 0.006, "share": 0.6},
    {"name": "small", "diameter": 0.0036, "share": 0.4},
]


def energy(scene: Scene, positions: np.ndarray, height: float) -> float:
    return evaluate(scene, positions, piston_height=height).potential_energy


def slope(values: tuple[float, float, float, float], step: float) -> float:
    """Derivative from the values at -2, -1, 1 and 2 steps, to fourth order."""
    far_before, before, after, far_after = values
    return (far_before - 8.0 * before + 8.0 * after - far_after) / (12.0 * step)


@pytest.mark.parametrize("species", [None, MIXTURE], ids=["mono", "mixture"])
@quick_in_plain_python
def test_force_is_minus_gradient(bed: Scene, species: list[dict[str, Any]] | None) -> None:
    scene = bed.replace(**{"grains.count": 30, "cell.width": "12 D", "arrangement.jitter": 0.15})
    if species:
        scene = scene.replace(**{"grains.species": species})
    positions = scene.initial_positions_and_velocities()[0]
    height, step = scene.piston.height, 2e-4 * 0.006
    here = evaluate(scene, positions)
    size = np.abs(here.force).max()
    assert size > 0.0
    for grain, axis in ((0, 0), (7, 1), (29, 0), (29, 1)):
        values = []
        for shift in (-2.0, -1.0, 1.0, 2.0):
            moved = positions.copy()
            moved[grain, axis] += shift * step
            values.append(energy(scene, moved, height))
        assert -slope(tuple(values), step) == pytest.approx(
            here.force[grain, axis], rel=1e-7, abs=1e-7 * size
        )


def test_piston_force_is_minus_gradient() -> None:
    scene = load_scene("bed")
    positions, height = scene.initial_positions_and_velocities()[0], scene.piston.height
    step = 2e-4 * 0.006
    values = tuple(energy(scene, positions, height + k * step) for k in (-2.0, -1.0, 1.0, 2.0))
    assert -slope(values, step) == pytest.approx(evaluate(scene, positions).piston_force, rel=1e-7)


def test_published_scales() -> None:
    """Masses, moments and units of the table of scales [D, Tables 2.1 and 4.3]."""
    from granular.schema.natural_units import MAGNETIC_CONSTANT, Scales

    expected = {
        0.006: (6.2498e-4, 0.08775, 2.37656, 1.25612e-3, 2.57715e-3, 4.1303),
        0.005: (4.3401e-4, 0.0609375, 2.37656, 9.5557e-4, 1.78969e-3, 4.5245),
        0.008: (1.11107e-3, 0.156, 2.37656, 1.93393e-3, 4.5816e-3, 3.5769),
    }
    bed = load_scene("bed")
    for diameter, (mass, moment, force, tau, gravity, balance) in expected.items():
        scene = bed.replace(
            **{
                "grains.species.0.diameter": diameter,
                "cell.width": 0.9,
                "piston.height": 0.3,
                "arrangement.height": 0.28,
            }
        )
        scales = Scales.from_grains(scene.grains)
        weight = 9.8 / scales.acceleration
        volume = math.pi * 0.003 * diameter**2 / 4.0
        assert scales.mass == pytest.approx(mass, rel=5e-5)
        assert 1.3 * volume / MAGNETIC_CONSTANT == pytest.approx(moment, rel=5e-5)
        assert scales.force == pytest.approx(force, rel=5e-6)
        assert scales.time == pytest.approx(tau, rel=5e-6)
        assert weight == pytest.approx(gravity, rel=5e-5)
        assert (0.75 / weight) ** 0.25 == pytest.approx(balance, rel=5e-5)
