"""Every effect of a scene, also custom ones, each added singly to dipoles and walls."""

import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import Scene, effect, evaluate, load_scene, quantity, simulate, stage, wall_law
from granular.effects.effect import EFFECTS
from granular.engine.state import make_initial_state
from granular.engine.tick_loop import constant_arrays_per_grain, remove_outflowed_grains
from granular.methods import METHODS
from granular.scene.scene_in_natural_units import scene_in_natural_units
from granular.user_code import import_user_code_and_collect_measures
from tests.commands.shown import files

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")

STEP = 4e-5


@effect
class HeightSpring:
    """A spring that pulls every grain towards a height, and oscillates in time."""

    k: float = quantity("N/m", default=1.0, above=0.0)
    height: float = quantity("m", default=0.02)
    omega: float = quantity("1/s", default=50.0)

    @staticmethod
    def energy(p: Any, grain: Any, time: float) -> Any:
        return 0.5 * p.k * (1.0 + 0.3 * math.sin(p.omega * time)) * (grain.y - p.height) ** 2

    @staticmethod
    def force(p: Any, grain: Any, time: float) -> Any:
        return 0.0, -p.k * (1.0 + 0.3 * math.sin(p.omega * time)) * (grain.y - p.height)

    @staticmethod
    def power(p: Any, grain: Any, time: float) -> Any:
        return 0.15 * p.k * p.omega * math.cos(p.omega * time) * (grain.y - p.height) ** 2

    @staticmethod
    def stiffness(p: Any, grain: Any, time: float) -> Any:
        return 1.3 * p.k


@effect
class Bumpers:
    """A repulsion of pairs with a smooth cut-off."""

    k: float = quantity("N/m", default=2.0)
    end: float = quantity("m", default=0.012)

    @staticmethod
    def pair_energy(p: Any, r: float, first: Any, second: Any) -> Any:
        return first.moment * second.moment * p.k * max(p.end - r, 0.0) ** 4 / p.end**2

    @staticmethod
    def pair_force(p: Any, r: float, first: Any, second: Any) -> Any:
        return 4.0 * first.moment * second.moment * p.k * max(p.end - r, 0.0) ** 3 / p.end**2

    @staticmethod
    def reach(p: Any) -> Any:
        return p.end


@effect
class FarPairs:
    """A spring between all grains."""

    k: float = quantity("N/m", default=0.05)

    @staticmethod
    def pair_energy(p: Any, r: float, first: Any, second: Any) -> Any:
        return 0.5 * p.k * r * r

    @staticmethod
    def pair_force(p: Any, r: float, first: Any, second: Any) -> Any:
        return -p.k * r


@effect
class Mud:
    """A drag that is equal for all grains."""

    gamma: float = quantity("kg/s", default=0.2)

    @staticmethod
    def flow(p: Any, grain: Any, vx: float, vy: float, dt: float) -> Any:
        left = math.exp(-p.gamma / grain.mass * dt)
        return left * vx, left * vy


@wall_law
class Soft:
    """A wall that pushes like a spring."""

    k: float = quantity("N/m", default=5.0)
    end: float = quantity("m", default=0.018)

    @staticmethod
    def energy(p: Any, w: float) -> Any:
        return p.k * max(p.end - w, 0.0) ** 4 / p.end**2

    @staticmethod
    def force(p: Any, w: float) -> Any:
        return 4.0 * p.k * max(p.end - w, 0.0) ** 3 / p.end**2

    @staticmethod
    def stiffness(p: Any, w: float) -> Any:
        return 12.0 * p.k * max(p.end - w, 0.0) ** 2 / p.end**2


@stage
class Dip:
    """The piston moves down and up again."""

    depth: float = quantity("m", above=0.0)
    omega: float = quantity("1/s")

    @staticmethod
    def height(p: Any, time: float, start: float) -> Any:
        return start - p.depth * (1.0 - math.cos(p.omega * time))


@stage
class Fade:
    """A force that decays and rotates."""

    size: float = quantity("N")
    span: float = quantity("s", above=0.0)

    @staticmethod
    def force(p: Any, time: float) -> Any:
        return p.size * (math.exp(-time / p.span) - math.sin(time / p.span))


GUIDE = ("springs.py", "oil.py", "rubber.py")
"""A force, a flow and a law of a wall, as the page on them has them."""

with tempfile.TemporaryDirectory() as folder:
    for file in GUIDE:
        (Path(folder) / file).write_text(files()[file], encoding="utf-8")
        import_user_code_and_collect_measures([Path(folder) / file])


OWN_WALLS = {
    "left": {"law": "soft", "k": "4 N/m"},
    "top": {"energy": "a*(l/w)**3", "a": "20 uJ", "l": "6 mm"},
}
NAMES = sorted(EFFECTS)
EXAMPLES: dict[str, Any] = {name: one.example for name, one in EFFECTS.items()}
EXAMPLES["own walls"] = OWN_WALLS
EXAMPLES["leaf_spring"] = {"k": "1 N/m", "height": "2 cm"}
EXAMPLES["oil"] = {"drag": "0.2 kg/s"}
EXAMPLES["walls of the guide"] = {"left": {"law": "rubber", "k": "9 N/m", "reach": "2 cm"}}
ALONE = {"dipole": True, "walls": True}


def small(name: str, **more: Any) -> Scene:
    """Return a scene of nine moving grains of two sizes, with one further effect."""
    scene = load_scene("bed").replace(
        **{
            "grains.count": 9,
            "grains.species": [
                {"name": "big", "diameter": "6 mm", "share": 0.6},
                {"name": "small", "diameter": "4 mm", "share": 0.4},
            ],
            "cell.width": "6 D",
            "piston.height": "6 D",
            "arrangement.height": "5.9 D",
            "arrangement.speed": "30 D/s",
            "arrangement.jitter": 0.1,
            "output": {"scalars": 5 * STEP, "frames": 10 * STEP},
            "effects": ALONE | {name if name in NAMES else "walls": EXAMPLES[name]},
        }
    )
    return scene.replace(**more)


def test_pair_forces_of_every_effect_conserve_momentum() -> None:
    for name in ("dipole", "contact", "bumpers", "far_pairs"):
        scene = small(name, **{"effects.walls": None, "piston": "none"})
        force = evaluate(scene, scene.initial_positions_and_velocities()[0] * [0.7, 0.9]).force
        assert np.abs(force.sum(axis=0)).max() < 1e-14 * np.abs(force).max() * len(force)


@pytest.mark.parametrize("name", EXAMPLES)
def test_error_of_the_energy_balance_with_every_effect_is_of_second_order_in_the_step(name: str) -> None:
    runs = [simulate(small(name), dt=dt, t_end=10 * STEP, progress=False) for dt in (STEP, STEP / 2)]
    coarse, fine = (float(one.settings()["ledger_residual"]) for one in runs)
    assert coarse < 1e-3
    assert 3.0 < coarse / fine < 5.0
    for variable in runs[0].dataset:
        if str(variable).endswith("_loss"):
            assert (np.diff(runs[0].dataset[variable].values) >= -1e-18).all()


@pytest.mark.parametrize("name", NAMES)
def test_stored_values_stay_with_their_grains_after_another_grain_leaves(name: str) -> None:
    gap = {"law": "slab", "gap_start": "2 D", "gap_end": "4 D"}
    scene = small(name)
    if name not in ("wall_friction", "host"):  # pushes a grain below the bottom; carries no gap
        scene = scene.replace(**{"effects.walls.bottom": gap})
    system = scene_in_natural_units(scene)
    positions = scene.initial_positions_and_velocities()[0] / system.scales.length
    method = METHODS["stormer-verlet"]
    state = make_initial_state(positions, 0.0 * positions, 6.0, system.constants.acting, method)
    before = [values.copy() for values in constant_arrays_per_grain(system.constants)]
    state.y[2] = -9.0
    left = remove_outflowed_grains(state, system.constants._replace(exit=-5.0))
    assert left.grains == len(positions) - 1
    present = state.label[: left.grains]
    assert 2 not in present
    for values, former in zip(constant_arrays_per_grain(left), before, strict=True):
        np.testing.assert_array_equal(values[: left.grains], former[present])


@pytest.mark.parametrize("name", NAMES)
def test_compiled_functions_get_laws_only_of_effects_in_the_scene(name: str) -> None:
    acting = scene_in_natural_units(small(name).replace(**{f"effects.{name}": None})).constants.acting
    others = set(ALONE) - {name, "dipole"}
    assert len(acting.laws) == len(others)


@pytest.mark.parametrize(
    "own",
    [
        {"kind": "dip", "depth": "0.05 D", "omega": "2000 1/s"},
        {"kind": "fade", "size": "0.5 N", "span": "0.2 ms"},
        {"kind": "path", "height": "h0 - a*(1 - cos(w*t))", "a": "0.05 D", "w": "2000 1/s"},
        {"kind": "force", "force": "f*exp(-t/s) - f*sin(t/s)", "f": "0.5 N", "s": "0.2 ms"},
    ],
    ids=lambda own: str(own["kind"]),
)
def test_energy_balance_of_a_custom_stage_is_closed(own: dict[str, Any]) -> None:
    """The stages are defined by a class and by a formula."""
    scene = small("walls", **{"piston.mass": "20 g", "output.scalars": 2 * STEP})
    scene = scene.replace(protocol=[{"name": "own", "duration": 20 * STEP} | own])
    assert Scene.from_plain(scene.to_plain()) == scene
    runs = [simulate(scene, dt=dt, progress=False) for dt in (STEP / 2, STEP / 4)]
    coarse, fine = (float(one.settings()["ledger_residual"]) for one in runs)
    assert 3.0 < coarse / fine < 5.0
    if own["kind"] in ("dip", "path"):
        data = runs[0].dataset
        wanted = 0.036 - 0.05 * 0.006 * (1.0 - np.cos(2000.0 * data["time"].values))
        np.testing.assert_allclose(data["piston_height"].values, wanted, rtol=0.0, atol=1e-12)
