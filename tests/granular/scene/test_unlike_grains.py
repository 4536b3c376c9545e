"""Grains of unlike material: their masses and moments, and that what is said of all alike is said of each."""

import math
from typing import Any

import numpy as np
import pytest

from granular import Scene, evaluate, load_scene

MU0 = 4e-7 * math.pi


def mixed(**changes: Any) -> Scene:
    """Big grains, and small ones of another remanence, density and thickness, that rub."""
    small = {"name": "small", "diameter": "4 mm", "share": 0.4, "remanence": "0.9 T"}
    return load_scene("bed").replace(
        **{
            "grains.count": 23,
            "grains.species": [
                {"name": "big", "diameter": "6 mm", "share": 0.6},
                small | {"density": 5000.0, "thickness": "2.9 mm"},
            ],
            "cell.width": "15 D",
            "piston.height": "8 D",
            "arrangement.height": "7 D",
            "effects.drag": None,
            "effects.friction": True,
            "effects.walls": dict.fromkeys(("left", "right", "bottom", "top"), "infinite"),
        }
        | changes
    )


def test_what_is_said_of_each_species_alike_changes_no_bit() -> None:
    scene = load_scene("bed").replace(**{"grains.count": 9})
    place = scene.initial_positions_and_velocities()[0]
    told = scene.replace(
        **{
            "grains.species.0.remanence": scene.grains.remanence,
            "grains.species.0.density": scene.grains.density,
            "grains.species.0.thickness": scene.grains.thickness,
        }
    )
    np.testing.assert_array_equal(evaluate(told, place).force, evaluate(scene, place).force)


def test_masses_and_moments_are_those_of_the_material() -> None:
    grains = mixed().grains
    sheet = math.pi / 4.0 * 0.004**2 * 0.0029
    assert grains.masses()[grains.species_indices() == 1] == pytest.approx(5000.0 * sheet, rel=1e-14)
    integer = math.pi / 4.0 * 0.006**2 * 0.003
    assert grains.moment_ratios()[1] == pytest.approx(0.9 * sheet / (1.3 * integer), rel=1e-14)
    spread = mixed(
        **{
            "grains.spread": 0.1,
            "grains.count": 400,
            "cell.width": "60 D",
            "piston.height": "40 D",
            "arrangement.height": "39 D",
        }
    )
    factors = spread.grains.moment_spread_factors()
    assert factors.std() == pytest.approx(0.1, rel=0.1)
    assert np.abs(factors - 1.0).max() <= 0.3 + 1e-15
