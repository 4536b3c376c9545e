"""Commands that know rectangles with one piston alone refuse other cells in one line."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from granular import damper

CHANGES: dict[str, dict[str, Any]] = {
    "cell.sides": {
        "cell": {
            "sides": [
                {"name": "left", "ends": [[0.0, 1.0], [0.0, 0.0]]},
                {"name": "floor", "ends": [[0.0, 0.0], [0.36, 0.0]]},
                {"name": "right", "ends": [[0.36, 0.0], [0.36, 1.0]]},
                {"name": "lid", "ends": [[0.36, 0.0], [0.0, 0.0]], "body": "piston"},
            ]
        }
    },
    "host": {
        "effects.host": {
            "mount": "base",
            "pistons": [{"name": "floor", "mass": 0.3, "side": "bottom"}],
            "springs": [{"upper": "floor", "stiffness": 2e4, "preload": 80.0}],
        }
    },
}


@pytest.mark.parametrize("key", CHANGES)
@pytest.mark.parametrize(
    "words",
    [("granular", "export", "--format", "lammps", "-o", "out"), ("reduced_models", "fall")],
    ids=["export", "fall"],
)
def test_a_polygon_and_a_further_piston_are_refused(
    key: str, words: tuple[str, ...], command: Callable[..., Any], tmp_path: Path
) -> None:
    package, name, *options = words
    scene = tmp_path / "scene.toml"
    scene.write_text(damper().replace(**CHANGES[key]).to_toml(), encoding="utf-8")
    done = command(package, name, str(scene), *options)
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert key in done.stderr
