"""A scene computes only the effects that it names: no array, and no trace in the machine code."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from granular import load_scene
from granular.engine.state import new_state
from granular.engine.system import natural_system
from granular.methods import METHODS

# Symbols of the specialised loop, compiled afresh (code from the disk cache cannot be read).
SCRIPT = """
import json, re, warnings
from granular import load_scene, simulate
from granular.engine.loop import advance
warnings.simplefilter("ignore")
scene = load_scene("single-particle").replace(**{
    "effects.dipole": None, "effects.walls": None, "effects.drag": None, "effects.gravity": None,
    "protocol": [{"kind": "hold", "name": "hold", "duration": 1e-4}]})
full = scene.replace(**{
    "effects.dipole": True, "effects.walls": True, "effects.drag": True, "effects.gravity": True,
    "effects.friction": True, "effects.contact": {"modulus": 1e7},
    "effects.shaking": {"amplitude": 1e-3, "frequency": 10.0},
    "arrangement.positions": None, "arrangement.velocities": None, "arrangement.height": "7 D",
    "grains.count": 9, "cell.width": "8 D", "piston.height": "8 D"})
found, seen = {}, set()
for name, one in (("bare", scene), ("full", full)):
    simulate(one, 1e-6, progress=False)
    (signature,) = set(advance.signatures) - seen
    seen.add(signature)
    code = advance.inspect_asm(signature)
    found[name] = [
        "expm1" in code, "hypot" in code, *sorted(set(re.findall(r"_ZN8granular\\w*", code)))]
print(json.dumps(found))
"""
TRACES = ("7effects", "5pairs", "ContactLaw", "_kick_with_friction", "4drag")


@pytest.fixture(scope="module")
def symbols(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    cache = str(tmp_path_factory.mktemp("cache"))
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        capture_output=True, text=True, check=True, cwd=Path(__file__).parents[2],
        env=os.environ | {"NUMBA_CACHE_DIR": cache},
    )  # fmt: skip
    return dict(json.loads(done.stdout))


def traces(symbols: list[str]) -> set[str]:
    return {trace for trace in TRACES for symbol in symbols[2:] if trace in symbol}


def test_compiled_code_holds_no_trace_of_absent_effects(symbols: dict[str, list[str]]) -> None:
    assert traces(symbols["bare"]) == set()
    assert len(traces(symbols["full"])) >= 4  # the same search finds them where they act
    assert symbols["bare"][1] is False
    assert symbols["full"][1] is True


@pytest.mark.parametrize("effect", ["friction", "contact", "shaking", "drag", "gravity", "dipole"])
def test_absent_effects_are_none_in_the_signature(effect: str) -> None:
    present = {"friction": True, "contact": {"modulus": 1e7}, "dipole": True, "gravity": True,
               "drag": True, "shaking": {"amplitude": 1e-3, "frequency": 1.0}}  # fmt: skip
    scene = load_scene("bed").replace(**{f"effects.{key}": val for key, val in present.items()})
    full = natural_system(scene).constants.acting
    bare = natural_system(scene.replace(**{f"effects.{effect}": None})).constants.acting
    if effect == "dipole":
        assert (full.dipole, bare.dipole) == (True, None)
    else:
        assert len(bare.laws) == len(full.laws) - 1


def test_absent_effects_allocate_nothing() -> None:
    """Only the arrays of motion and one scratch array are left."""
    scene = load_scene("bed").replace(**{"effects.drag": None})
    system = natural_system(scene)
    start = ([[1.0, 1.0]] * scene.grains.count,) * 2

    def arrays(**changes: object) -> set[str]:
        acting = natural_system(scene.replace(**changes)).constants.acting
        state = new_state(*map(np.array, start), 20.0, acting, METHODS["stormer-verlet"])
        held = {name for name, value in state._asdict().items() if value is not None}
        rooms = {type(room).__name__ for room in state.rooms if room is not None}
        return (held - {"rooms"}) | rooms

    bare = arrays()
    assert system.constants.masses is None
    assert bare == {"x", "y", "vx", "vy", "fx", "fy", "piston", "ledger", "clock", "wall_forces",
                    "label", "scratch"}  # fmt: skip
    assert arrays(**{"effects.friction": True}) - bare == {"load"}
    assert arrays(**{"effects.contact": {"modulus": 1e7}}) - bare == {"ClosePairs"}
    slab = {"law": "slab"}
    assert arrays(**{"effects.walls.bottom": slab}) - bare == {"ndarray"}
