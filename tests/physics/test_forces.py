"""Every conservative effect: force = -gradient of the energy, momentum, symmetry."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
import pytest

from granular import Scene, evaluate, load_scene

ALONE = {
    "dipole": {"effects.walls": None, "effects.gravity": None},
    "walls": {"effects.dipole": None, "effects.gravity": None},
    "gravity": {"effects.dipole": None, "effects.walls": None},
    "all": {},
}
MIXTURE = [
    {"name": "big", "diameter": 0.006, "share": 0.6},
    {"name": "small", "diameter": 0.0036, "share": 0.4},
]


COMPILED = ("dipole-mono", "walls-mono", "all-mono", "all-mixture")
"""Beds that are compiled for other tests as well, or hold all; the others are quick in plain Python
alone, where `tests/architecture/test_plain_python.py` takes them."""


def scenes() -> list[Any]:
    bed = load_scene("bed").replace(**{"grains.count": 30, "cell.width": "12 D", "arrangement.jitter": 0.15})
    mixed = bed.replace(**{"grains.species": MIXTURE})
    found = {
        f"{name}-{kind}": scene.replace(**changes)
        for name, changes in ALONE.items()
        for kind, scene in (("mono", bed), ("mixture", mixed))
    }
    return [
        pytest.param(
            scene, id=name, marks=() if numba.config.DISABLE_JIT or name in COMPILED else pytest.mark.long
        )
        for name, scene in found.items()
    ]


def energy(scene: Scene, positions: np.ndarray, height: float) -> float:
    return evaluate(scene, positions, piston_height=height).potential_energy


def slope(values: tuple[float, float, float, float], step: float) -> float:
    """Derivative from the values at -2, -1, 1 and 2 steps, to fourth order."""
    far_before, before, after, far_after = values
    return (far_before - 8.0 * before + 8.0 * after - far_after) / (12.0 * step)


@pytest.mark.parametrize("scene", scenes())
def test_force_is_minus_gradient(scene: Scene) -> None:
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


@pytest.mark.parametrize("species", [None, MIXTURE], ids=["mono", "mixture"])
def test_pair_forces_have_no_net_momentum(bed: Scene, species: list | None) -> None:
    scene = bed.replace(**ALONE["dipole"])
    if species:
        scene = scene.replace(**{"grains.species": species})
    force = evaluate(scene, scene.initial_positions_and_velocities()[0]).force
    assert np.abs(force.sum(axis=0)).max() < 1e-14 * np.abs(force).sum()


def test_wall_forces_balance_the_grains(bed: Scene) -> None:
    scene = bed.replace(**ALONE["walls"])
    found = evaluate(scene, scene.initial_positions_and_velocities()[0])
    walls = found.wall_forces
    assert found.force[:, 0].sum() == pytest.approx(walls["left"] - walls["right"], rel=1e-12)
    assert found.force[:, 1].sum() == pytest.approx(walls["bottom"] - walls["top"], rel=1e-12)
    assert found.piston_force == walls["top"] > 0.0


def test_mirror_symmetry(bed: Scene) -> None:
    positions = bed.initial_positions_and_velocities()[0]
    mirrored = positions.copy()
    mirrored[:, 0] = bed.cell.width - mirrored[:, 0]
    left, right = evaluate(bed, positions), evaluate(bed, mirrored)
    size = np.abs(left.force).max()
    np.testing.assert_allclose(left.force[:, 0], -right.force[:, 0], atol=1e-11 * size)
    np.testing.assert_allclose(left.force[:, 1], right.force[:, 1], atol=1e-11 * size)
    assert left.potential_energy == pytest.approx(right.potential_energy, rel=1e-13)


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


def test_two_grains_repel_as_dipoles() -> None:
    """3 mu0 mu^2/(4 pi r^4) in SI, from the moment itself."""
    bed = load_scene("bed").replace(**ALONE["dipole"])
    scene = bed.replace(**{"grains.count": 2})
    distance, moment = 0.017, 0.08775
    force = evaluate(scene, np.array([[0.1, 0.05], [0.1 + distance, 0.05]])).force
    wanted = 3.0 * 4e-7 * math.pi * moment**2 / (4.0 * math.pi * distance**4)
    assert force[1, 0] == pytest.approx(wanted, rel=1e-6)
    assert force[1, 1] == 0.0
