"""Drag by the size of a grain, alone and with what is solved together with it."""

from typing import Any

import numpy as np
import pytest

from granular import Scene, load_scene, simulate

DENSE = [
    {"name": "light", "diameter": "6 mm", "share": 0.5},
    {"name": "heavy", "diameter": "4 mm", "share": 0.5, "density": 16000.0, "thickness": "2 mm"},
]


def apart(species: list[dict[str, Any]], **changes: Any) -> Scene:
    """Two grains that feel drag alone."""
    plate = {"conductivity": 0.0, "thickness": "1 mm", "distance": "4 mm", "mutual": True}
    return load_scene("single-particle").replace(
        **{
            "grains.count": 2,
            "grains.species": species,
            "cell.width": "400 D",
            "piston": "none",
            "arrangement.positions": [[0.6, 0.6], [1.2, 0.9]],
            "arrangement.velocities": [[0.1, -0.05], [0.1, -0.05]],
            "arrangement.height": None,
            "effects": {"drag": {"coefficient": "0.01 kg/s"}, "eddy": plate, "dipole": "none"},
            "protocol": [{"kind": "hold", "name": "hold", "duration": 0.1}],
            "output": {"scalars": 1e-3, "frames": 0.1, "record": "none"},
        }
        | changes
    )


@pytest.mark.parametrize("coefficient", [0.01, 0.0])
def test_drag_goes_with_the_area_of_a_face(coefficient: float) -> None:
    scene = apart(DENSE, **{"effects.drag.coefficient": coefficient})
    run = simulate(scene, dt=1e-4, progress=False)
    faces = coefficient * np.array([1.0, (4.0 / 6.0) ** 2])
    left = np.exp(-0.1 * faces / scene.grains.masses())
    velocity = run.dataset["velocity"].values
    np.testing.assert_allclose(velocity[-1], left[:, None] * velocity[0], rtol=1e-9)
    data = run.dataset
    total = (data["kinetic_energy"] + data["drag_loss"]).values
    np.testing.assert_allclose(total, total[0], rtol=1e-10)


def test_dry_friction_takes_the_drag_of_each_grain_along() -> None:
    """Compare with v = (v0 + b/c) exp(-c t) - b/c under the drag c and the deceleration b."""
    scene = apart(
        DENSE,
        **{
            # Gravity, of no size, and no eddy currents: as in the tests of one grain that rubs.
            "effects.gravity": {"acceleration": 0.0},
            "effects.eddy": None,
            "effects.friction": {"load": "2 mN", "static": 0.4, "dynamic": 0.3},
            "protocol": [{"kind": "hold", "name": "hold", "duration": 0.02}],
        },
    )
    velocity = simulate(scene, dt=2e-5, progress=False).dataset["velocity"].values
    masses = scene.grains.masses()
    c, b = 0.01 * np.array([1.0, 4.0 / 9.0]) / masses, 0.3 * 2e-3 / masses
    before, after = np.hypot(*velocity[0].T), np.hypot(*velocity[-1].T)
    exact = (before + b / c) * np.exp(-0.02 * c) - b / c
    np.testing.assert_allclose(after, exact, rtol=1e-6)
