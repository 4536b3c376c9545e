"""Effects and laws of a user's own: what is wrong is told in a line, and nothing is stale."""

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
from granular.effects.custom_law import Laws
from granular.effects.effect import EFFECTS
from granular.effects.pair_law import Species
from granular.run.summary import custom_code_digests
from granular.scene.scene_in_natural_units import scene_in_natural_units
from granular.shared.errors import GranularError, InputError
from granular.studies.cases import find_measure, make_cases
from granular.user_code import import_user_code

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
from granular.user_code import import_user_code
import_user_code([sys.argv[1]])
scene = load_scene("single-particle").replace(effects={{"leaf": {{"k": "2 N/m"}}}})
print(evaluate(scene, np.array([[0.05, 0.05]])).force[0, 1])
{COUNTED}"""

OF_A_WALL = f"""
import sys
from pathlib import Path
from granular import load_scene
from granular.engine.step_size import evaluate_highest_impact_frequency
from granular.scene.scene_in_natural_units import scene_in_natural_units
from granular.user_code import import_user_code
import_user_code([sys.argv[1]])
wall = {{"law": "bench_wall", "k": "9 N/m"}}
scene = load_scene("single-particle").replace(**{{"effects.walls.bottom": wall}})
print(evaluate_highest_impact_frequency(scene_in_natural_units(scene).constants, 2.0) ** 2)
{COUNTED}"""


def bed(**effects: Any) -> Scene:
    return load_scene("bed").replace(**{f"effects.{name}": one for name, one in effects.items()})


def made(name: str = "Leaf", **functions: Callable[..., Any]) -> Any:
    """An effect with these functions, and a parameter k."""
    content = {name: staticmethod(one) for name, one in functions.items()}
    content |= {"__annotations__": {"k": "float"}, "k": quantity("N/m", default=1.0)}
    return effect(type(name, (), content))


def _energy(p: Any, grain: Any, time: float) -> Any:
    return 0.5 * p.k * grain.y**2


def _double(p: Any, grain: Any, time: float) -> Any:
    return 0.0, -2.0 * p.k * grain.y


def _failing(p: Any, grain: Any, time: float) -> Any:
    return 0.0, -p.stiff * grain.y


def _swinging(p: Any, grain: Any, time: float) -> Any:
    return 0.5 * p.k * grain.y**2 * (1.0 + math.sin(time))


def _swung(p: Any, grain: Any, time: float) -> Any:
    return 0.0, -p.k * grain.y * (1.0 + math.sin(time))


def _push(p: Any, grain: Any, vx: float, vy: float, total_duration: float) -> Any:
    return vx + total_duration, vy


def _halving(p: Any, grain: Any, vx: float, vy: float, total_duration: float) -> Any:
    return vx / (1.0 + total_duration) ** 2 * 1.0, vy * (1.0 - 0.1 * total_duration)


def _pair(p: Any, r: float, first: Any, second: Any) -> Any:
    return p.k * first.moment / r


def _apart(p: Any, r: float, first: Any, second: Any) -> Any:
    return p.k * first.moment / r**2


MIXED = [{"name": name, "diameter": size, "share": 0.5} for name, size in (("a", 6e-3), ("b", 5e-3))]


@pytest.mark.parametrize(
    ("functions", "words"),
    [
        ({"energy": _energy, "force": _double}, "'force' gives .* where its energy asks for"),
        ({"energy": _energy, "force": _failing}, "'force' fails: AttributeError"),
        ({"energy": _swinging, "force": _swung}, "'power' gives 0 where its energy asks for"),
        ({"flow": _push}, "'flow' makes a grain faster"),
        ({"flow": _halving}, "'flow' over two spans is not that over both together"),
        ({"pair_energy": _pair, "pair_force": _apart}, "a pair must pull and push equally"),
    ],
)
def test_what_does_not_fit_together_is_told_in_a_line(functions: Any, words: str) -> None:
    made(**functions)
    scene = bed(leaf=True).replace(**{"grains.species": MIXED})
    with pytest.raises(InputError, match=words) as told:
        scene_in_natural_units(scene)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("functions", "words"),
    [
        ({"energy": _energy}, "does nothing"),
        ({"force": _double}, "has no 'energy'"),
        ({"energy": _energy, "force": _double, "stifness": _energy}, "did you mean 'stiffness'"),
    ],
)
def test_what_is_missing_is_told_at_once(functions: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        made(**functions)


def test_a_class_that_is_refused_leaves_nothing_behind() -> None:
    EFFECTS.load()  # those of the package are defined now
    before = dict(vars(Laws))
    with pytest.raises(InputError, match="'drag' is built in"):
        made("Drag", energy=_energy, force=_swung)
    functions = {"energy": staticmethod(_energy), "force": staticmethod(_double)}
    with pytest.raises(InputError, match="k must be a number"):
        effect(type("Plain", (), {**functions, "__annotations__": {"k": "float"}, "k": 3.0}))
    assert before == dict(vars(Laws))


def test_scenes_check_an_own_effect_as_any_other() -> None:
    made(energy=_energy, force=_double)
    for changes, words in (
        ({"effects.leaf": {"k": "3 N"}}, "effects.leaf.k: '3 N' has the unit N"),
        ({"effects.leaf": {"kk": 3.0}}, "effects.leaf: unknown key 'kk'; did you mean 'k'"),
        ({"effects.leav": True}, "did you mean 'leaf'.*--import FILE"),
    ):
        with pytest.raises(GranularError, match=words) as told:
            load_scene("bed").replace(**changes)
        assert "\n" not in str(told.value)
    scene = bed(leaf={"k": "3 N/m"})
    assert scene.effects.leaf.k == 3.0
    assert Scene.from_plain(scene.to_plain()) == scene


@pytest.mark.parametrize(
    ("field", "words"),
    [
        ({"energy": "k*y", "k": "1 N/m"}, "energy: it is in m kg s\\^-2, not in J"),
        ({"energy": "k*y**2 + z", "k": "1 N/m"}, "unknown name 'z'"),
        ({"energy": "k*sin(x)", "k": "1 J"}, "sin of something in m"),
        ({"energy": "k*y**2 + l", "k": "1 N/m", "l": "1 m"}, "are added or compared"),
        ({"energy": "k*(y", "k": "1 N"}, "a bracket is not closed"),
        ({"energy": "k*y", "k": "1 N", "q": 1.0}, "the energy has no 'q'"),
        ({"energy": "k*y", "k": "1 N", "factor": {"huge": 2.0}}, "unknown species 'huge'"),
    ],
)
def test_what_is_wrong_with_a_formula_is_told_in_a_line(field: Any, words: str) -> None:
    with pytest.raises(GranularError, match=words) as told:
        bed(field=[field])
    assert "\n" not in str(told.value)


def test_work_is_derived_where_the_time_is_in_a_formula() -> None:
    still = {"energy": "k*y**2/2", "k": "1 N/m"}
    turning = {"energy": "k*y**2/2*cos(w*t)", "k": "1 N/m", "w": "60 1/s"}
    known = [bed(field=[one]).effects.field.fields[0].definition.functions for one in (still, turning)]
    assert "power" not in known[0]
    assert "power" in known[1]


@pytest.mark.parametrize("step", ["heaviside(y - h)", "sign(y/h - 1)"])
def test_a_formula_that_jumps_is_refused(step: str) -> None:
    pytest.importorskip("sympy")
    jump = {"energy": f"k*{step}", "k": "1 J", "h": "5 mm"}
    definition = bed(field=[jump]).effects.field.fields[0].definition
    with pytest.raises(InputError, match="jumps"):
        definition.functions["force"]


@pytest.mark.parametrize("compressed", ["max(l - r, 0)", "-min(r - l, 0)", "abs(min(0, r - l))"])
def test_the_kink_of_a_pair_s_formula_is_read(compressed: str) -> None:
    """A spring that acts on one side."""
    law = {"energy": f"a*({compressed})**2/l**2", "a": "2 uJ", "l": "1 D", "reach": "2 D"}
    scene = load_scene("bed").replace(effects={"pair_law": [law]}, piston="none")
    definition = scene.effects.pair_law.component_effects[0].definition
    functions, p, grain = definition.functions, definition.law(2.0, 1.0), Species(1.0, 1.0, 1.0)
    for r in (0.25, 0.75, 1.0, 1.5):
        within = max(1.0 - r, 0.0)
        assert functions["pair_energy"](p, r, grain, grain) == pytest.approx(2 * within**2)


def test_a_kink_at_a_ratio_of_a_wall_s_parameters_compiles() -> None:
    """SymPy leaves the derivative of sign(1 - w/l) as it is, where l may be zero."""
    law = {"energy": "a*abs(1 - w/l)", "a": "2 uJ", "l": "1 D"}
    scene = load_scene("bed").replace(**{"effects.walls.left": law})
    functions = scene.effects.walls.wall_of("left").own.definition.functions
    for w in (0.5, 1.5):
        assert functions["energy"]((2.0, 1.0), w) == pytest.approx(1.0)
        assert functions["force"]((2.0, 1.0), w) == pytest.approx(2.0 if w < 1.0 else -2.0)
        assert functions["stiffness"]((2.0, 1.0), w) == 0.0


def test_a_wall_law_that_is_no_gradient_is_told() -> None:
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
    with pytest.raises(InputError, match=r"'force' gives .* where its energy asks for"):
        scene_in_natural_units(scene)


def test_an_edit_is_another_run_and_another_case(tmp_path: Path) -> None:
    found = []
    for factor in ("1.0", "2.0"):
        path = tmp_path / f"own{factor}.py"
        path.write_text(FILE.format(factor=factor, name="Leaf"), encoding="utf-8")
        import_user_code([path])
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


def test_what_does_not_compile_is_told_in_a_line() -> None:
    def mixed(p: Any, grain: Any, time: float) -> Any:
        return 0.0, -p.k * grain.y * SCALES.one

    made(energy=_energy, force=mixed)
    scene = load_scene("single-particle").replace(effects={"leaf": True})
    with pytest.raises(InputError, match="'leaf': 'force' does not compile") as told:
        evaluate(scene, np.array([[0.05, 0.05]]))
    assert "\n" not in str(told.value)


def test_a_wall_law_that_does_not_compile_is_told_in_a_line() -> None:
    def mixed(p: Any, w: float) -> Any:
        return SCALES.one * p.k / w**3

    functions = {"energy": lambda p, w: 0.5 * p.k / w**2, "force": mixed, "stiffness": mixed}
    content: dict[str, Any] = {name: staticmethod(one) for name, one in functions.items()}
    content |= {"__annotations__": {"k": "float"}, "k": quantity("N/m", default=1.0)}
    wall_law(type("MixedWall", (), content))
    walls = {"left": {"law": "mixed_wall"}, "right": None, "bottom": None, "top": None}
    scene = load_scene("single-particle").replace(effects={"walls": walls})
    with pytest.raises(InputError, match="wall law 'mixed_wall': 'force' does not compile") as told:
        evaluate(scene, np.array([[0.05, 0.05]]))
    assert "\n" not in str(told.value)


def test_an_installed_package_brings_effects(installed: Callable[..., None]) -> None:
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


def test_an_installed_package_brings_laws_of_walls(installed: Callable[..., None]) -> None:
    installed("wall_laws", WALL, {"bench_wall": "BenchWall"})
    scene = load_scene("bed").replace(**{"effects.walls.left": {"law": "bench_wall", "k": "9 N/m"}})
    assert scene.to_plain()["effects"]["walls"]["left"]["law"] == "bench_wall"
    with pytest.raises(InputError, match="bench_wal"):
        load_scene("bed").replace(**{"effects.walls.left": {"law": "bench_wal", "k": "9 N/m"}})


@pytest.mark.parametrize(
    ("program", "text", "wanted"),
    [
        # At a given speed a grain turns where the wall is the stiffer, the weaker it is: 3 v^4/k.
        (OF_A_WALL, WALL.replace("p.k", "{factor} * p.k"), (1.0, 1.0, 1.0 / 3.0)),
        pytest.param(OF_AN_EFFECT, FILE, (-0.1, -0.1, -0.3), marks=pytest.mark.long),
    ],
    ids=["wall", "effect"],
)
def test_a_second_process_compiles_nothing_and_an_edit_anew(
    tmp_path: Path, program: str, text: str, wanted: tuple[float, ...]
) -> None:
    path, cache = tmp_path / "own.py", tmp_path / "cache"
    cache.mkdir()
    told = []
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
        told.append([float(word) for word in done.stdout.split()])
    found = [number for number, _ in told]
    scale = found[0] / wanted[0] if program == OF_A_WALL else 1.0
    tolerance = 1e-9 if program == OF_A_WALL else 1e-12
    assert found == pytest.approx([scale * one for one in wanted], rel=tolerance)
    assert told[0][1] == told[1][1] < told[2][1]
