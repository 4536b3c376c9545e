"""User-defined effects and wall laws: errors take one line, and outdated compiled code is not used."""

import math
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from granular import Scene, effect, evaluate, load_scene, quantity, wall_law
from granular.effects.custom_law import CustomLawRegistry
from granular.effects.effect import EFFECTS
from granular.effects.pair_law import Species
from granular.run.summary import custom_code_digests
from granular.scene.scene_in_natural_units import scene_in_natural_units
from granular.shared.errors import GranularError, InputError
from granular.studies.cases import find_measure, make_cases
from granular.user_code import import_user_code_and_collect_measures

SCALES = SimpleNamespace(one=1.0)
ROOT = Path(__file__).parents[3]

FILE = '''
import math

from granular import effect, quantity

STRONGER = {factor}


@effect
class {name}:
    """A spring that pulls every grain down."""

    k: float = quantity("N/m", above=0.0)

    @staticmethod
    def energy(p, grain, time):
        return 0.5 * STRONGER * p.k * grain.y**2

    @staticmethod
    def force(p, grain, time):
        return 0.0, -STRONGER * p.k * grain.y
'''

COUNTED = """
print(sum(1 for _ in Path(sys.argv[2]).rglob("*.kernel")))
"""

OF_AN_EFFECT = f"""
import sys
from pathlib import Path
import numpy as np
from granular import evaluate, load_scene
from granular.user_code import import_user_code_and_collect_measures
import_user_code_and_collect_measures([sys.argv[1]])
scene = load_scene("single-particle").replace(effects={{"leaf": {{"k": "2 N/m"}}}})
print(evaluate(scene, np.array([[0.05, 0.05]])).force[0, 1])
{COUNTED}"""

OF_A_WALL = f"""
import sys
from pathlib import Path
from granular import load_scene
from granular.engine.step_size import highest_impact_frequency_from_python
from granular.scene.scene_in_natural_units import scene_in_natural_units
from granular.user_code import import_user_code_and_collect_measures
import_user_code_and_collect_measures([sys.argv[1]])
wall = {{"law": "bench_wall", "k": "9 N/m"}}
scene = load_scene("single-particle").replace(**{{"effects.walls.bottom": wall}})
print(highest_impact_frequency_from_python(scene_in_natural_units(scene).constants, 2.0) ** 2)
{COUNTED}"""


def bed(**effects: Any) -> Scene:
    return load_scene("bed").replace(**{f"effects.{name}": one for name, one in effects.items()})


def make_effect(name: str = "Leaf", **functions: Callable[..., Any]) -> Any:
    """Define an effect with these functions and a parameter k."""
    content = {name: staticmethod(one) for name, one in functions.items()}
    content |= {"__annotations__": {"k": "float"}, "k": quantity("N/m", default=1.0)}
    return effect(type(name, (), content))


def _energy(p: Any, grain: Any, time: float) -> Any:
    return 0.5 * p.k * grain.y**2


def _double(p: Any, grain: Any, time: float) -> Any:
    return 0.0, -2.0 * p.k * grain.y


def _failing(p: Any, grain: Any, time: float) -> Any:
    return 0.0, -p.stiff * grain.y


def _oscillating_energy(p: Any, grain: Any, time: float) -> Any:
    return 0.5 * p.k * grain.y**2 * (1.0 + math.sin(time))


def _oscillating_force(p: Any, grain: Any, time: float) -> Any:
    return 0.0, -p.k * grain.y * (1.0 + math.sin(time))


def _accelerating(p: Any, grain: Any, vx: float, vy: float, total_duration: float) -> Any:
    return vx + total_duration, vy


def _inexact(p: Any, grain: Any, vx: float, vy: float, total_duration: float) -> Any:
    return vx / (1.0 + total_duration) ** 2 * 1.0, vy * (1.0 - 0.1 * total_duration)


def _asymmetric_energy(p: Any, r: float, first: Any, second: Any) -> Any:
    return p.k * first.moment / r


def _asymmetric_force(p: Any, r: float, first: Any, second: Any) -> Any:
    return p.k * first.moment / r**2


MIXED = [{"name": name, "diameter": size, "share": 0.5} for name, size in (("a", 6e-3), ("b", 5e-3))]


@pytest.mark.parametrize(
    ("functions", "words"),
    [
        ({"energy": _energy, "force": _double}, "'force' returns .*, but the derivative of the energy"),
        ({"energy": _energy, "force": _failing}, "'force' fails: AttributeError"),
        (
            {"energy": _oscillating_energy, "force": _oscillating_force},
            "'power' returns 0, but the derivative of the energy requires",
        ),
        ({"flow": _accelerating}, "'flow' increases a grain's speed"),
        ({"flow": _inexact}, "'flow' applied twice with dt differs from 'flow' applied once"),
        (
            {"pair_energy": _asymmetric_energy, "pair_force": _asymmetric_force},
            "use an energy that is symmetric in the two grains",
        ),
    ],
)
def test_custom_effect_with_inconsistent_functions_gives_a_one_line_error(functions: Any, words: str) -> None:
    make_effect(**functions)
    scene = bed(leaf=True).replace(**{"grains.species": MIXED})
    with pytest.raises(InputError, match=words) as raised:
        scene_in_natural_units(scene)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("functions", "words"),
    [
        ({"energy": _energy}, "no function that can act"),
        ({"force": _double}, "has no 'energy'"),
        ({"energy": _energy, "force": _double, "stifness": _energy}, "did you mean 'stiffness'"),
    ],
)
def test_custom_effect_with_a_missing_or_unknown_function_is_refused_at_its_definition(
    functions: Any, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        make_effect(**functions)


def test_a_rejected_effect_class_is_not_registered() -> None:
    EFFECTS.load()  # so that the laws of the package are registered before
    before = dict(vars(CustomLawRegistry))
    with pytest.raises(InputError, match="'drag' is built in"):
        make_effect("Drag", energy=_energy, force=_oscillating_force)
    functions = {"energy": staticmethod(_energy), "force": staticmethod(_double)}
    with pytest.raises(InputError, match="k is not declared as a number"):
        effect(type("Plain", (), {**functions, "__annotations__": {"k": "float"}, "k": 3.0}))
    assert before == dict(vars(CustomLawRegistry))


def test_scenes_check_parameters_of_a_custom_effect() -> None:
    make_effect(energy=_energy, force=_double)
    for changes, words in (
        ({"effects.leaf": {"k": "3 N"}}, "effects.leaf.k: '3 N' has the unit N"),
        ({"effects.leaf": {"kk": 3.0}}, "effects.leaf: unknown key 'kk'; did you mean 'k'"),
        ({"effects.leav": True}, "did you mean 'leaf'.*--import FILE"),
    ):
        with pytest.raises(GranularError, match=words) as raised:
            load_scene("bed").replace(**changes)
        assert "\n" not in str(raised.value)
    scene = bed(leaf={"k": "3 N/m"})
    assert scene.effects.leaf.k == 3.0
    assert Scene.from_plain(scene.to_plain()) == scene


@pytest.mark.parametrize(
    ("field", "words"),
    [
        ({"energy": "k*y", "k": "1 N/m"}, "energy: the value is in m kg s\\^-2, but J is required"),
        ({"energy": "k*y**2 + z", "k": "1 N/m"}, "unknown name 'z'"),
        ({"energy": "k*sin(x)", "k": "1 J"}, "has an argument in m"),
        ({"energy": "k*y**2 + l", "k": "1 N/m", "l": "1 m"}, "are added or compared"),
        ({"energy": "k*(y", "k": "1 N"}, "a bracket is not closed"),
        ({"energy": "k*y", "k": "1 N", "q": 1.0}, "'q' does not occur in energy"),
        ({"energy": "k*y", "k": "1 N", "factor": {"huge": 2.0}}, "unknown species 'huge'"),
    ],
)
def test_error_in_the_formula_of_a_field_is_reported_in_one_line(field: Any, words: str) -> None:
    with pytest.raises(GranularError, match=words) as raised:
        bed(field=[field])
    assert "\n" not in str(raised.value)


def test_power_of_a_field_is_derived_only_if_its_formula_depends_on_time() -> None:
    """The power is the partial derivative of the energy by time, which is zero for other formulas."""
    constant = {"energy": "k*y**2/2", "k": "1 N/m"}
    oscillating = {"energy": "k*y**2/2*cos(w*t)", "k": "1 N/m", "w": "60 1/s"}
    functions = [
        bed(field=[field]).effects.field.fields[0].definition.functions for field in (constant, oscillating)
    ]
    assert "power" not in functions[0]
    assert "power" in functions[1]


@pytest.mark.parametrize("step", ["heaviside(y - h)", "sign(y/h - 1)"])
def test_discontinuous_energy_formula_of_a_field_is_an_error(step: str) -> None:
    pytest.importorskip("sympy")
    jump = {"energy": f"k*{step}", "k": "1 J", "h": "5 mm"}
    definition = bed(field=[jump]).effects.field.fields[0].definition
    with pytest.raises(InputError, match="jumps"):
        definition.functions["force"]


@pytest.mark.parametrize("compressed", ["max(l - r, 0)", "-min(r - l, 0)", "abs(min(0, r - l))"])
def test_energy_formula_of_a_pair_may_have_a_discontinuous_second_derivative(compressed: str) -> None:
    """The example is a spring that acts only in compression."""
    law = {"energy": f"a*({compressed})**2/l**2", "a": "2 uJ", "l": "1 D", "reach": "2 D"}
    scene = load_scene("bed").replace(effects={"pair_law": [law]}, piston="none")
    definition = scene.effects.pair_law.component_effects[0].definition
    functions, p, grain = definition.functions, definition.law_class(2.0, 1.0), Species(1.0, 1.0, 1.0)
    for r in (0.25, 0.75, 1.0, 1.5):
        within = max(1.0 - r, 0.0)
        assert functions["pair_energy"](p, r, grain, grain) == pytest.approx(2 * within**2)


def test_energy_formula_of_a_wall_with_a_kink_compiles() -> None:
    """SymPy leaves the derivative of sign(1 - w/l) unevaluated, since it allows l = 0."""
    law = {"energy": "a*abs(1 - w/l)", "a": "2 uJ", "l": "1 D"}
    scene = load_scene("bed").replace(**{"effects.walls.left": law})
    functions = scene.effects.walls.wall_of("left").own.definition.functions
    for w in (0.5, 1.5):
        assert functions["energy"]((2.0, 1.0), w) == pytest.approx(1.0)
        assert functions["force"]((2.0, 1.0), w) == pytest.approx(2.0 if w < 1.0 else -2.0)
        assert functions["stiffness"]((2.0, 1.0), w) == 0.0


def test_custom_wall_force_that_is_not_the_negative_derivative_of_the_energy_is_an_error() -> None:
    @wall_law
    class Wrong:
        k: float = quantity("N/m", default=1.0)

        @staticmethod
        def energy(p: Any, w: float) -> float:
            return float(p.k / w)

        @staticmethod
        def force(p: Any, w: float) -> float:
            return float(p.k / w)

        @staticmethod
        def stiffness(p: Any, w: float) -> float:
            return float(p.k / w)

    scene = bed(**{"walls.left": {"law": "wrong"}})
    with pytest.raises(InputError, match=r"'force' returns .*, but the derivative of the energy requires"):
        scene_in_natural_units(scene)


def test_editing_a_custom_effect_changes_the_digests_of_its_runs_and_study_cases(tmp_path: Path) -> None:
    found = []
    for factor in ("1.0", "2.0"):
        path = tmp_path / f"own{factor}.py"
        path.write_text(FILE.format(factor=factor, name="Leaf"), encoding="utf-8")
        import_user_code_and_collect_measures([path])
        scene = bed(leaf={"k": "1 N/m"})
        measure = find_measure("last-values")
        (case,) = make_cases(
            scene, {"grains.count": [9]}, [], {"dt": "auto", "method": "stormer-verlet"}, measure
        )
        found.append((custom_code_digests(scene), case.key))
        again = pickle.loads(pickle.dumps(scene))
        assert again == scene
        assert custom_code_digests(again) == custom_code_digests(scene)
    assert found[0][0] != found[1][0]
    assert found[0][1] != found[1][1]


def test_compilation_failure_of_an_effect_is_a_one_line_error() -> None:
    def mixed(p: Any, grain: Any, time: float) -> Any:
        return 0.0, -p.k * grain.y * SCALES.one

    make_effect(energy=_energy, force=mixed)
    scene = load_scene("single-particle").replace(effects={"leaf": True})
    with pytest.raises(InputError, match="'leaf': 'force' does not compile") as raised:
        evaluate(scene, np.array([[0.05, 0.05]]))
    assert "\n" not in str(raised.value)


def test_compilation_failure_of_a_wall_law_is_a_one_line_error() -> None:
    def mixed(p: Any, w: float) -> Any:
        return SCALES.one * p.k / w**3

    functions = {"energy": lambda p, w: 0.5 * p.k / w**2, "force": mixed, "stiffness": mixed}
    content: dict[str, Any] = {name: staticmethod(one) for name, one in functions.items()}
    content |= {"__annotations__": {"k": "float"}, "k": quantity("N/m", default=1.0)}
    wall_law(type("MixedWall", (), content))
    walls = {"left": {"law": "mixed_wall"}, "right": None, "bottom": None, "top": None}
    scene = load_scene("single-particle").replace(effects={"walls": walls})
    with pytest.raises(InputError, match="wall law 'mixed_wall': 'force' does not compile") as raised:
        evaluate(scene, np.array([[0.05, 0.05]]))
    assert "\n" not in str(raised.value)


def test_effects_of_an_installed_package_are_found(installed: Callable[..., None]) -> None:
    source = FILE.format(factor=2.0, name="BenchSpring")
    installed("effects", source, {"bench_spring": "BenchSpring", "gone_spring": "Gone"})
    assert {"bench_spring", "gone_spring"} <= set(EFFECTS)
    scene = load_scene("bed").replace(**{"effects.bench_spring.k": "3 N/m"})
    assert scene.to_plain()["effects"]["bench_spring"]["k"] == pytest.approx(3.0)
    with pytest.raises(InputError, match=r"'gone_spring' of laboratory 1\.0 cannot be loaded"):
        load_scene("bed").replace(**{"effects.gone_spring.k": "3 N/m"})


WALL = """
from granular import quantity, wall_law


@wall_law
class BenchWall:
    k: float = quantity("N/m", above=0.0)

    @staticmethod
    def energy(p, w):
        return 0.5 * p.k / w**2

    @staticmethod
    def force(p, w):
        return p.k / w**3

    @staticmethod
    def stiffness(p, w):
        return 3.0 * p.k / w**4
"""


def test_wall_laws_of_an_installed_package_are_found(installed: Callable[..., None]) -> None:
    installed("wall_laws", WALL, {"bench_wall": "BenchWall"})
    scene = load_scene("bed").replace(**{"effects.walls.left": {"law": "bench_wall", "k": "9 N/m"}})
    assert scene.to_plain()["effects"]["walls"]["left"]["law"] == "bench_wall"
    with pytest.raises(InputError, match="bench_wal"):
        load_scene("bed").replace(**{"effects.walls.left": {"law": "bench_wal", "k": "9 N/m"}})


@pytest.mark.parametrize(
    ("program", "text", "wanted"),
    [
        # At a given speed, the stiffness at the turning point is 3 v^4/k: larger for a weaker wall.
        (OF_A_WALL, WALL.replace("p.k", "{factor} * p.k"), (1.0, 1.0, 1.0 / 3.0)),
        pytest.param(OF_AN_EFFECT, FILE, (-0.1, -0.1, -0.3), marks=pytest.mark.long),
    ],
    ids=["wall", "effect"],
)
def test_second_process_uses_cached_code_of_a_custom_effect_and_recompiles_it_after_an_edit(
    tmp_path: Path, program: str, text: str, wanted: tuple[float, ...]
) -> None:
    path, cache = tmp_path / "own.py", tmp_path / "cache"
    cache.mkdir()
    outputs = []
    for factor in ("1.0", "1.0", "3.0"):
        path.write_text(text.format(factor=factor, name="Leaf"), encoding="utf-8")
        done = subprocess.run(
            [sys.executable, "-c", program, str(path), str(cache)],
            capture_output=True,
            text=True,
            check=True,
            cwd=ROOT,
            env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
        )
        outputs.append([float(word) for word in done.stdout.split()])
    found = [number for number, _ in outputs]
    scale = found[0] / wanted[0] if program == OF_A_WALL else 1.0
    tolerance = 1e-9 if program == OF_A_WALL else 1e-12
    assert found == pytest.approx([scale * number for number in wanted], rel=tolerance)
    assert outputs[0][1] == outputs[1][1] < outputs[2][1]
