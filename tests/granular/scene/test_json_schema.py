"""JSON schemas accept valid scenes and, like the reader of scenes, refuse scenes with a single wrong key."""

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest

from granular import Scene, load_scene
from granular.scene.json_schema import scene_schema, study_schema
from granular.scene.named_scenes import SCENES, scene_names
from granular.shared.errors import SceneError

jsonschema = pytest.importorskip("jsonschema")

GOOD = {
    "effects.gravity": True,
    "effects.drag": {"coefficient": "0.2 kg/s"},
    "effects.walls": {"left": "infinite", "right": "none", "bottom": {"law": "slab"}},
    "effects.field": [{"energy": "k*y**2/2", "k": "10 N/m"}],
    "effects.friction": {"static": 0.5, "dynamic": 0.4},
    "pairs.method": "direct",
    "piston.mass": "none",
    "grains.count": 40,
    "protocol": [{"kind": "hold", "name": "stay", "duration": "1 s"}],
    "output.record": "none",
}
BAD = {
    "grains.count": -3,
    "grains.mixing": "shaken",
    "grains.colour": "red",
    "cell.width": 0.0,
    "effects.gravity": {"strength": 9.81},
    "effects.magic": True,
    "effects.friction": {"static": -1.0},
    "protocol": [{"kind": "jump"}],
    "arrangement.positions": [[0.01]],
    "name": "",
}


@pytest.fixture(scope="module")
def admits() -> Any:
    validator = jsonschema.Draft202012Validator(scene_schema())
    validator.check_schema(validator.schema)
    return validator.is_valid


def with_change(path: str, value: object) -> dict[str, Any]:
    plain: dict[str, Any] = tomllib.loads((SCENES / "bed.toml").read_text(encoding="utf-8"))
    *above, last = path.split(".")
    table = plain
    for key in above:
        if not isinstance(table.get(key), dict):
            table[key] = {}
        table = table[key]
    table[last] = value
    return plain


@pytest.mark.parametrize("name", scene_names())
def test_json_schema_accepts_packaged_scenes(name: str, admits: Any) -> None:
    assert admits(tomllib.loads((SCENES / f"{name}.toml").read_text(encoding="utf-8")))
    assert admits(load_scene(name).to_plain())


@pytest.mark.parametrize("path", GOOD)
def test_json_schema_accepts_valid_scenes(path: str, admits: Any) -> None:
    plain = with_change(path, GOOD[path])
    assert admits(plain)
    Scene.from_plain(plain)


@pytest.mark.parametrize("path", BAD)
def test_json_schema_refuses_invalid_scenes(path: str, admits: Any) -> None:
    plain = with_change(path, BAD[path])
    assert not admits(plain)
    with pytest.raises(SceneError):
        Scene.from_plain(plain)


def test_keys_of_the_json_schema_have_descriptions_units_and_limits() -> None:
    width = scene_schema()["properties"]["cell"]["properties"]["width"]
    assert "side walls" in width["description"]
    number, text = width["anyOf"][0]["anyOf"]
    assert number == {"type": "number", "exclusiveMinimum": 0.0}
    assert "m" in text["description"]


def test_json_schema_accepts_only_valid_studies(tmp_path: Path) -> None:
    admits = jsonschema.Draft202012Validator(study_schema()).is_valid
    study = {
        "scene": "damper",
        "dt": "auto*2",
        "grid": {"piston.mass": [6.0, 7.5]},
        "cases": [{"piston.mass": "9 kg", "dt": "auto"}],
    }
    assert admits(study)
    for wrong in ({"grid": {}}, study | {"grids": {}}, study | {"cases": {}}, study | {"dt": -1.0}):
        assert not admits(wrong)


@pytest.mark.parametrize("kind", ["scene", "study"])
def test_command_prints_or_writes_the_json_schema(kind: str, tmp_path: Path, command: Any) -> None:
    printed = command("granular", "schema", "--of", kind).stdout
    assert json.loads(printed)["title"].startswith(kind)
    file = tmp_path / "it.json"
    command("granular", "schema", "--of", kind, "-o", str(file))
    assert file.read_text(encoding="utf-8") == printed
