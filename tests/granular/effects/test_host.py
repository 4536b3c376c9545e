"""Motion of a machine that carries the bed, compared with exact solutions, and checks of such scenes."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import load_scene, simulate
from granular.methods import METHODS
from granular.pairs.far_field import FarFieldSettings
from granular.run.trajectory import Trajectory
from granular.scene.scene import Scene
from granular.scene.scene_in_natural_units import scene_in_natural_units
from granular.shared.errors import InputError, SceneError

ROOT = Path(__file__).parents[3]
MASS, STIFFNESS, DAMPING = 2.0, 800.0, 3.0
BODY = {"mass": MASS, "stiffness": STIFFNESS, "damping": DAMPING}
RESONANCE = math.sqrt(STIFFNESS / MASS) / math.tau


def scene(duration: float = 2.0, **changes: Any) -> Scene:
    """Return a scene of a machine without a damper."""
    plain = {
        "name": "host",
        "grains": {"count": 0, "species": [{"diameter": "6 mm"}]},
        "cell": {"width": "60 D"},
        "piston": {"height": "20 D"},
        "effects": {"host": {"bodies": [BODY]}},
        "protocol": [{"name": "shake", "kind": "hold", "duration": duration}],
        "output": {"scalars": "2 ms", "frames": "0.1 s"},
    }
    return Scene.from_plain(plain).replace(**changes)


def force(frequency: float, size: float = 2.0) -> dict[str, Any]:
    return {"kind": "sine", "force": size, "frequency": frequency}


def run(scene: Scene, dt: float | str = "auto") -> Trajectory:
    return simulate(scene, dt=dt, progress=False)


def solve_from_rest(rate: Any, trajectory: Trajectory, state_count: int) -> np.ndarray:
    time = trajectory.dataset.time.values
    solution = solve_ivp(
        rate, (0.0, time[-1]), np.zeros(state_count), t_eval=time, rtol=1e-10, atol=1e-14, max_step=0.01
    )
    return np.asarray(solution.y)


def relative_error(computed: np.ndarray, exact: np.ndarray) -> float:
    return float(np.abs(computed - exact).max() / np.abs(exact).max())


@pytest.mark.long  # quick: the ledger of a host and friction, in plain Python
@pytest.mark.parametrize("ratio", [0.3, 0.6, 0.9, 1.2, 2.0, 3.0])
def test_sticking_grains_act_as_an_added_mass_of_the_host(ratio: float) -> None:
    count = 6
    loaded = {
        "grains.count": count,
        "grains.density": "2e6 kg/m^3",
        "effects.gravity": True,
        "effects.dipole": True,
        "effects.friction": {"load": "50 N"},
    }
    mass = count * 2e6 * math.pi / 4.0 * 0.006**2 * 0.003
    omega = math.tau * ratio * RESONANCE
    # With friction the automatic step is four times as long as in other scenes.
    trajectory = run(
        scene(**loaded).replace(**{"effects.host.excitation": force(ratio * RESONANCE)}), "auto/2"
    )
    x, _ = solve_from_rest(
        lambda t, y: [y[1], (2.0 * math.sin(omega * t) - DAMPING * y[1] - STIFFNESS * y[0]) / (MASS + mass)],
        trajectory,
        2,
    )
    assert mass > 0.5
    assert relative_error(trajectory.dataset.host_displacement.values, x) < 2e-3
    assert trajectory.settings()["ledger_residual"] < 1e-5
    assert np.ptp(trajectory.dataset.position.values[1:], axis=0).max() == 0.0


BED = {
    "grains.count": 24,
    "cell.width": "16 D",
    "piston.height": "8 D",
    "piston.mass": 0.4,
    "effects.dipole": True,
    "effects.walls": True,
    "effects.gravity": True,
    "arrangement.height": "7 D",
    "arrangement.speed": "1e-2 D/s",
    "effects.host.bodies": [{"mass": 2.0, "stiffness": 800.0}],
    "effects.host.excitation": force(3.0),
    "protocol": [{"name": "shake", "kind": "free", "duration": 0.02}],
}


def test_scene_of_a_machine_with_inconsistent_values_is_an_error() -> None:
    with pytest.raises(SceneError, match=r"0 of force, acceleration, displacement are given"):
        scene(**{"effects.host.excitation": {"frequency": "3 Hz"}})
    with pytest.raises(SceneError, match="already moves the cell"):
        scene(**{"effects.shaking": {"amplitude": "1 mm", "frequency": "3 Hz"}})
    with pytest.raises(SceneError, match="is required for mount"):
        scene(**{"effects.host.cell_mass": "1 kg"})
    with pytest.raises(InputError, match="use 'stormer-verlet'"):
        simulate(scene(), method="runge-kutta-4", progress=False)


def test_distant_forces_in_a_bed_on_a_machine_are_computed_in_every_step() -> None:
    """Impulses every few steps would act on the grains but not on the machine."""
    bed = scene(**BED, **{"pairs.method": "mesh"})
    assert far_field_settings(bed).every is None
    assert far_field_settings(bed.replace(**{"effects.host": None})).every is not None
    with pytest.raises(InputError, match=r"far_every = 4: a host needs the whole force"):
        far_field_settings(bed.replace(**{"pairs.far_every": 4}))


def far_field_settings(scene: Scene) -> FarFieldSettings:
    far = scene_in_natural_units(scene, method=METHODS["stormer-verlet"]).constants.acting.far
    assert far is not None
    return far


@pytest.mark.parametrize(
    ("effects", "words"),
    [
        ({"walls": {"left": {"law": "slab", "length": "20 D"}}}, "wall 'slab' exerts a tangential force"),
        ({"walls": {"left": {"law": "discs", "pitch": "1.3 D"}}}, "wall 'discs' exerts a tangential force"),
        ({"wall_friction": {"coefficient": 0.2}}, "friction at this side is not supported"),
    ],
)
def test_tangential_wall_force_on_an_inclined_second_piston_is_an_error(
    effects: dict[str, Any], words: str
) -> None:
    host = {"mount": "base", "pistons": [{"name": "ram", "mass": 0.3, "side": "left"}]}
    host["springs"] = [{"upper": "ram", "stiffness": 2000.0}]
    scene = load_scene("bed")
    with pytest.raises(SceneError, match=words):
        scene.replace(**{f"effects.{key}": value for key, value in effects.items()}, **{"effects.host": host})
