"""Drag, eddy currents, field gradient and wall friction compared with exact motions of single grains."""

import math
from typing import Any

import numpy as np
import pytest

from granular import Scene, Trajectory, load_scene, simulate
from granular.effects.eddy_drag import Eddy
from granular.effects.wall_laws import InfiniteWall
from granular.schema.natural_units import Scales
from granular.shared.errors import SceneError
from tests.modes import quick_in_plain_python

MU0 = 4e-7 * math.pi
PLATE = {"conductivity": "59.6 MS/m", "thickness": "1 mm", "distance": "4 mm"}


def alone(**changes: Any) -> Scene:
    """Return a scene with one grain halfway between infinite side walls.

    It contains all effects, with zero strength by default.
    """
    scene = load_scene("single-particle").replace(
        **{
            "grains.count": 1,
            "cell.width": "6 D",
            "piston": "none",
            "arrangement.positions": [["3 D", "50 D"]],
            "arrangement.velocities": None,
            "arrangement.height": None,
            "effects": {
                "walls": {"left": "infinite", "right": "infinite", "bottom": "none", "top": "none"},
                "gravity": {"acceleration": 0.0},
                "eddy": PLATE | {"conductivity": 0.0},
                "gradient": True,
                "wall_friction": {"coefficient": 0.0},
            },
            "protocol": [{"kind": "hold", "name": "hold", "duration": 0.2}],
            "output": {"scalars": 1e-3, "frames": 0.02, "record": "none"},
        }
    )
    return scene.replace(**changes)


def run(dt: float = 2e-4, **changes: Any) -> Trajectory:
    return simulate(alone(**changes), dt=dt, progress=False)


def vertical_motion(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Return time and vertical velocity of each frame."""
    return trajectory.dataset["frame_time"].values, trajectory.dataset["velocity"].values[:, 0, 1]


def test_eddy_drag_at_low_speed_equals_the_drag_computed_with_a_receding_image_dipole() -> None:
    grains = load_scene("single-particle").grains
    scales = Scales.from_grains(grains)
    moment = grains.remanence * math.pi / 4.0 * scales.length**2 * grains.thickness / MU0
    w = 2.0 / (MU0 * 59.6e6 * 1e-3)
    v = 1e-3 * w
    lift = 3.0 * MU0 * moment**2 / (32.0 * math.pi * 0.004**4) * (1.0 - w / math.hypot(v, w))
    assert Eddy.from_plain(PLATE).dipole_drag_coefficient(scales) * v == pytest.approx(w / v * lift, rel=1e-5)
    both = Eddy.from_plain(PLATE | {"plates": 2}).dipole_drag_coefficient(scales)
    assert both == 2.0 * Eddy.from_plain(PLATE).dipole_drag_coefficient(scales)


@quick_in_plain_python
def test_force_in_a_field_gradient_is_magnetic_moment_times_gradient() -> None:
    found = run(**{"effects.gradient.y": "-0.05 T/m"})
    scales = Scales.from_grains(found.scene.grains)
    time, v = vertical_motion(found)
    moment = scales.current * scales.length**2
    np.testing.assert_allclose(v, -0.05 * moment / scales.mass * time, rtol=1e-10, atol=1e-15)


@quick_in_plain_python
def test_grain_between_walls_with_friction_slides_or_stays_exactly_at_rest() -> None:
    scales = Scales.from_grains(alone().grains)
    normal = 2.0 * InfiniteWall.force(None, 3.0) * scales.force
    weight = 9.8 * scales.mass
    hold = weight / normal  # coefficient that just holds the grain
    stays = run(**{"effects.gravity.acceleration": 9.8, "effects.wall_friction.coefficient": 1.01 * hold})
    assert (stays.dataset["position"].values == stays.dataset["position"].values[0]).all()
    slides = run(**{"effects.gravity.acceleration": 9.8, "effects.wall_friction.coefficient": 0.4 * hold})
    time, v = vertical_motion(slides)
    np.testing.assert_allclose(v, -0.6 * 9.8 * time, rtol=1e-10, atol=1e-15)
    lost = 0.4 * weight * 0.5 * 0.6 * 9.8 * slides.dataset["time"].values[-1] ** 2
    assert float(slides.dataset["wall_friction_loss"][-1]) == pytest.approx(lost, rel=1e-9)


def test_wall_friction_requires_a_side_wall_whose_force_depends_on_the_distance() -> None:
    for walls in ({"left": "none", "right": "none", "bottom": "none", "top": "none"}, "none"):
        with pytest.raises(SceneError, match="no side wall for friction"):
            alone(**{"effects.walls": walls})
    slab = {"law": "slab", "length": "99 D"}
    with pytest.raises(SceneError, match="use 'infinite'"):
        alone(**{"effects.walls.left": slab})
    with pytest.raises(SceneError, match="cannot act together with 'friction'"):
        load_scene("bed").replace(**{"effects.friction": True, "effects.wall_friction.coefficient": 0.1})


DENSE = [
    {"name": "light", "diameter": "6 mm", "share": 0.5},
    {"name": "heavy", "diameter": "4 mm", "share": 0.5, "density": 16000.0, "thickness": "2 mm"},
]


def two_grains_with_drag(species: list[dict[str, Any]], **changes: Any) -> Scene:
    """Return a scene with two grains subject only to drag."""
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
def test_drag_is_proportional_to_the_face_area_of_a_grain(coefficient: float) -> None:
    scene = two_grains_with_drag(DENSE, **{"effects.drag.coefficient": coefficient})
    run = simulate(scene, dt=1e-4, progress=False)
    faces = coefficient * np.array([1.0, (4.0 / 6.0) ** 2])
    decay = np.exp(-0.1 * faces / scene.grains.masses())
    velocity = run.dataset["velocity"].values
    np.testing.assert_allclose(velocity[-1], decay[:, None] * velocity[0], rtol=1e-9)
    data = run.dataset
    total = (data["kinetic_energy"] + data["drag_loss"]).values
    np.testing.assert_allclose(total, total[0], rtol=1e-10)


def test_grain_with_dry_friction_and_drag_stops_as_in_the_closed_form() -> None:
    """The velocity is v = (v0 + b/c) exp(-ct) - b/c, with drag rate c and deceleration b by friction."""
    scene = two_grains_with_drag(
        DENSE,
        **{
            # Zero gravity and no eddy currents, as in the test of one grain with friction.
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
