"""Orders of convergence, from errors relative to exact solutions at several time steps.

Drag lowers the order if it is added to the forces; `tests/plain_python/test_orders_and_bits.py` tests
this.
"""

import numpy as np
import pytest

from granular import Scene, load_scene, simulate


def bouncing(**changes: object) -> Scene:
    return load_scene("single-particle").replace(
        **{
            "arrangement.positions": [["30 D", "3 D"]],
            "output.scalars": 0.05,
            "output.frames": 0.05,
            **changes,
        }
    )


def heights(scene: Scene, dt: float) -> np.ndarray:
    run = simulate(scene, dt=dt, t_end=0.05, progress=False)
    return run.dataset["position"].values[-1, 0]


def slope(scene: Scene, steps: tuple[float, ...], exact: np.ndarray) -> float:
    errors = [np.linalg.norm(heights(scene, dt) - exact) for dt in steps]
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


STEPS = (2e-5, 1e-5, 5e-6, 2.5e-6)


def reference(scene: Scene) -> np.ndarray:
    """Return the exact final position [m].

    It is computed by SciPy's DOP853 with tolerance 1e-13 from the formulas of the force laws.
    """
    from scipy.integrate import solve_ivp

    from granular.schema.natural_units import Scales

    scales = Scales.from_grains(scene.grains)
    gravity = scene.effects.gravity.acceleration / scales.acceleration
    rate = scene.effects.drag.decay_rate(scales) if scene.effects.drag else 0.0

    def motion(_: float, state: np.ndarray) -> list[float]:
        y, v = state
        return [v, 0.5 / y**3.5 - gravity - rate * v]

    total_duration = 0.05 / scales.time
    found = solve_ivp(motion, (0.0, total_duration), [3.0, 0.0], "DOP853", rtol=1e-13, atol=1e-15)
    return np.array([30.0 * scales.length, found.y[0, -1] * scales.length])


def test_verlet_converges_with_order_two_for_a_grain_at_a_repelling_wall() -> None:
    scene = bouncing()
    assert slope(scene, STEPS, reference(scene)) == pytest.approx(2.0, abs=0.02)


@pytest.mark.long  # quick: by differences of steps, in tests/plain_python/test_orders_and_bits.py
def test_verlet_converges_with_order_two_for_a_grain_with_drag_at_a_wall() -> None:
    scene = bouncing(**{"effects.drag.coefficient": 0.02})
    assert slope(scene, STEPS, reference(scene)) == pytest.approx(2.0, abs=0.02)


def test_motion_of_a_free_piston_converges_with_order_two(small_damper: Scene) -> None:
    scene = small_damper.replace(**{"output.scalars": 0.02, "output.frames": 0.02})

    def height(dt: float) -> float:
        return float(simulate(scene, dt=dt, t_end=0.02, progress=False).dataset["piston_height"][-1])

    steps = (4e-5, 2e-5, 1e-5)
    finest = height(1e-6)
    errors = [abs(height(dt) - finest) for dt in steps]
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(2.0, abs=0.1)
