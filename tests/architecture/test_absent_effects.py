"""Effects that a scene does not contain use no memory and no compiled code."""

import pickle
import re
from typing import Any

import numba
import numpy as np
import pytest

from granular import Scene, load_scene, simulate
from granular.engine.state import make_initial_state
from granular.engine.tick_loop import advance_ticks
from granular.methods import METHODS
from granular.scene.scene_in_natural_units import scene_in_natural_units
from granular.shared.files import read_sealed_file
from tests.physics.test_contact import head_on_collision
from tests.physics.test_friction import lone_grain

TRACES = ("7effects", "5pairs", "ContactLaw", "_kick_with_friction")
BARE = {"effects.dipole": None, "effects.walls": None, "effects.drag": None, "effects.gravity": None}


def symbols(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the names of the toolkit's functions in the cached machine code of a scene's time loop."""
    asked: list[tuple[Any, ...]] = []

    def spy(*arguments: Any) -> Any:
        asked.append(tuple(map(numba.typeof, arguments)))
        return advance_ticks(*arguments)

    monkeypatch.setattr("granular.run.engines.advance_ticks", spy)
    simulate(scene, 1e-6, 1e-4, progress=False)
    place = advance_ticks._cache._kernel_file_and_label(
        asked[0], advance_ticks.overloads[asked[0]].library.codegen
    )
    body = read_sealed_file(*place)
    assert body is not None
    _, (library, *_) = pickle.loads(body)
    _, _, (code, _) = library
    return sorted({name.decode() for name in re.findall(rb"_ZN8granular\w*|log1p", code)})


def traces(symbols: list[str]) -> set[str]:
    return {trace for trace in TRACES for symbol in symbols if trace in symbol}


def test_compiled_code_of_a_scene_has_no_functions_of_absent_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    bare = symbols(load_scene("single-particle").replace(**BARE), monkeypatch)
    assert any("advance" in symbol for symbol in bare)
    assert traces(bare) == set()
    assert "log1p" not in bare
    # The same search finds them in scenes that contain them, in code compiled by other tests.
    rubbing = symbols(lone_grain(), monkeypatch)
    touching = symbols(head_on_collision(0.1, 0.5), monkeypatch)
    assert traces(rubbing) | traces(touching) == set(TRACES)
    assert "log1p" in rubbing


def test_effects_absent_from_a_scene_allocate_no_arrays() -> None:
    """Only the arrays of the motion and one scratch array are allocated."""
    scene = load_scene("bed").replace(**{"effects.drag": None})
    system = scene_in_natural_units(scene)
    start = ([[1.0, 1.0]] * scene.grains.count,) * 2

    def arrays(**changes: object) -> set[str]:
        acting = scene_in_natural_units(scene.replace(**changes)).constants.acting
        state = make_initial_state(*map(np.array, start), 20.0, acting, METHODS["stormer-verlet"])
        held = {name for name, value in state._asdict().items() if value is not None}
        workspaces = {type(workspace).__name__ for workspace in state.workspaces if workspace is not None}
        return (held - {"workspaces"}) | workspaces

    bare = arrays()
    assert system.constants.masses is None
    assert bare == {
        "x",
        "y",
        "vx",
        "vy",
        "fx",
        "fy",
        "bodies",
        "piston",
        "ledger",
        "clock",
        "wall_forces",
        "label",
        "scratch",
    }
    assert arrays(**{"effects.friction": True}) - bare == {"load"}
    assert arrays(**{"effects.contact": {"modulus": 1e7}}) - bare == {"NearList"}
    slab = {"law": "slab"}
    assert arrays(**{"effects.walls.bottom": slab}) == bare
