"""Grains of unlike material: against sums over all pairs, and in the limit of like ones."""

from __future__ import annotations

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


def brute(scene: Scene, place: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """Force [N] and energy [J] of pairs, walls and weight, and the load [N], pair by pair."""
    grains = scene.grains
    diameter, species = grains.diameters(), grains.species_indices()
    thickness, remanence, density = (
        grains.species_values(name)[species] for name in ("thickness", "remanence", "density")
    )
    volume = math.pi / 4.0 * diameter**2 * thickness
    moment = remanence * volume / MU0 * grains.moment_spread_factors()
    first = remanence[0] * volume[0] / MU0
    force, load = np.zeros_like(place), np.zeros(len(place))
    energy = 0.0
    gap = scene.cell.separation
    lean = np.arctan(thickness / diameter)
    tilt = np.arcsin(gap / np.hypot(diameter, thickness)) - lean
    for i in range(len(place)):
        for j in range(len(place)):
            if i != j:
                apart = place[i] - place[j]
                r = float(np.hypot(*apart))
                strength = MU0 * moment[i] * moment[j] / (4.0 * math.pi)
                force[i] += 3.0 * strength / r**5 * apart
                energy += 0.5 * strength / r**3
                arm = np.cos(tilt[i]) * np.sin(tilt[j]) / np.cos(lean[i] + tilt[i])
                load[i] += 3.0 * strength / r**3 * arm / np.hypot(diameter[i], thickness[i])
    # The wall's strength goes with the first species' moment: q F* D^3/w^3.
    unit = MU0 * first**2 / (math.pi * diameter[0] ** 4)
    assert scene.piston is not None
    top = scene.piston.height
    gaps = [
        (place[:, 0], 0, 1),
        (scene.cell.width - place[:, 0], 0, -1),
        (place[:, 1], 1, 1),
        (top - place[:, 1], 1, -1),
    ]
    for w, axis, sign in gaps:
        force[:, axis] += sign * moment / first * unit * (diameter[0] / w) ** 3
        energy += float((moment / first * unit * diameter[0] * 0.5 * (diameter[0] / w) ** 2).sum())
    weight = density * volume * scene.effects.gravity.acceleration
    force[:, 1] -= weight
    return force, energy + float((weight * place[:, 1]).sum()), load


ONE = {"grains.species": [{"name": "big", "diameter": "6 mm"}]}


@pytest.mark.parametrize(
    "changes",
    [{}, {"grains.spread": 0.1}, ONE | {"grains.spread": 0.1}],
    ids=["two species", "two that spread", "one that spreads"],
)
def test_unlike_grains_follow_the_sums_over_pairs(changes: dict[str, Any]) -> None:
    scene = mixed(**changes)
    place = scene.initial_positions_and_velocities()[0]
    found = evaluate(scene, place)
    force, energy, load = brute(scene, place)
    scale = np.abs(force).max()
    np.testing.assert_allclose(found.force, force, rtol=0.0, atol=1e-12 * scale)
    assert found.potential_energy == pytest.approx(energy, rel=1e-12)
    np.testing.assert_allclose(found.normal_load, load, rtol=1e-12)


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
