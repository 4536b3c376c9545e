"""A method of the user's own: run, resumed, swept, and from the command line."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import Method, load_scene, load_trajectory, simulate
from granular.__main__ import main
from granular.commands.console import launch
from granular.methods import METHODS
from granular.run.summary import run_text
from granular.shared.errors import InputError, StoreError

PLAIN = METHODS["position-verlet"]
TWIN = Method("twin", 2, kicks=PLAIN.kicks, drifts=PLAIN.drifts)
OTHER = Method("twin", 2, kicks=(0.5, 0.5), drifts=(1.0,))
"""Another method of the same name."""

SCENE = load_scene("single-particle")
END = 0.02


def positions(**words: Any) -> np.ndarray:
    run = simulate(SCENE, dt=1e-4, t_end=END, progress=False, **words)
    return np.asarray(run.dataset["position"].values)


def test_the_same_table_makes_the_same_bits() -> None:
    assert (positions(method=TWIN) == positions(method="position-verlet")).all()
    assert (positions(method=TWIN.to_plain()) == positions(method=TWIN)).all()
    assert (positions(method=OTHER) != positions(method=TWIN)).any()


def test_the_table_stands_in_the_settings_and_is_asked_for_again(tmp_path: Path) -> None:
    words: dict[str, Any] = {"dt": 1e-4, "t_end": END, "progress": False, "out": tmp_path / "run"}
    simulate(SCENE, method=TWIN, **words)
    kept = load_trajectory(tmp_path / "run")
    assert kept.settings()["method"] == TWIN.to_plain()
    assert kept.method == TWIN
    assert "(twin, dt" in run_text(kept)
    with pytest.raises(StoreError, match="has another method"):
        simulate(SCENE, method=OTHER, resume=True, **words)
    again = simulate(SCENE, method=TWIN, resume=True, **words)
    assert again.complete


def test_the_command_line_takes_it_by_import(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.py").write_text(
        "from granular import Method\nm = Method('on-the-line', 2, kicks=(0, 1, 0), drifts=(0.5, 0.5))\n"
    )
    words = ["run", "single-particle", "--dt", "1e-4", "--t-end", "0.02", "--json", "--quiet"]
    words += ["--method", "on-the-line"]
    assert launch(main, [*words, "--import", str(tmp_path / "mine.py")]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["method"]["drifts"] == [0.5, 0.5]


def test_what_the_scene_cannot_take_is_said() -> None:
    scene = load_scene("bed").replace(**{"effects.friction": {}})
    backward = Method("backward", 4, kicks=METHODS["pefrl"].kicks, drifts=METHODS["pefrl"].drifts)
    with pytest.raises(InputError, match="method = 'backward' cannot run a scene with"):
        simulate(scene, method=backward, progress=False)
