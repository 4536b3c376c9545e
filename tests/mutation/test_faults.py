"""Planted faults change one position of a file, which remains valid Python."""

import ast
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

HERE = Path(__file__).parent
ROOT = HERE.parents[1]


def loaded(name: str) -> ModuleType:
    """Load a script next to this file."""
    spec = importlib.util.spec_from_file_location(f"mutation_{name}", HERE / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


faults, covering = loaded("faults"), loaded("covering")

SOURCE = '''
"""Words: a + b, and 2 * c."""

SHARE = 0.5
NAME = "a + b"


def kick(v: list[float], f: list[float], h: float) -> float:
    """More words: a - b."""
    if h < 0.0:
        raise ValueError(f"{h + 1.0} is wrong, {2 * h}")
    for i in range(1):
        for j in range(2):
            v[i] += 0.5 * h * f[j]
    drift(v)
    return -v[0]
'''


def changed() -> dict[str, set[str]]:
    """Return all changes of the source above, by kind."""
    found: dict[str, set[str]] = {}
    for one in faults.faults(SOURCE, "kick.py"):
        found.setdefault(one.kind, set()).add(f"{one.before} -> {one.after}")
    return found


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        ("sign", "v[i] += 0.5 * h * f[j] -> v[i] -= 0.5 * h * f[j]"),
        ("sign", "-v[0] -> (v[0])"),
        ("factor", "0.5 -> 1.0"),
        ("factor", "0.5 * h -> 0.5 / h"),
        ("factor", "0.5 * h * f[j] -> (0.5 * h)"),
        ("index", "v[i] -> v[j]"),
        ("index", "v[0] -> v[1]"),
        ("comparison", "h < 0.0 -> h > 0.0"),
        ("dropped", "drift(v) -> pass"),
        ("dropped", "v[i] += 0.5 * h * f[j] -> pass"),
    ],
)
def test_each_kind_of_planted_fault_is_generated(kind: str, change: str) -> None:
    assert change in changed()[kind]


def test_planted_faults_do_not_change_docstrings_strings_or_error_messages() -> None:
    befores = {change.split(" -> ")[0] for found in changed().values() for change in found}
    assert not befores & {"h + 1.0", "2 * h", "a + b", "range(1)"}


def found(path: Path) -> list:
    """Return all possible faults in a file."""
    return list(faults.faults(path.read_text(encoding="utf-8"), path.name))


@pytest.fixture(scope="module")
def draw() -> list:
    return faults.drawn(ROOT, seed=1, count=40)


def test_planted_faults_are_determined_by_the_seed(tmp_path: Path) -> None:
    """For speed, only one file of each folder is used."""
    for folder in (one for folders in faults.AREAS.values() for one in folders):
        first = next((path for path in sorted((ROOT / folder).rglob("*.py")) if found(path)), None)
        if first is not None:
            place = tmp_path / first.relative_to(ROOT)
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(first.read_bytes())
    draw = faults.drawn(tmp_path, seed=1, count=40)
    assert faults.drawn(tmp_path, seed=1, count=40) == draw
    assert faults.drawn(tmp_path, seed=2, count=40) != draw
    assert faults.drawn(tmp_path, seed=1, count=12) == draw[:12]


def test_planted_faults_are_drawn_equally_from_each_folder_and_include_every_kind(draw: list) -> None:
    assert len(set(draw)) == 40
    for folders in faults.AREAS.values():
        assert sum(one.path.startswith(folders) for one in draw) == 10
    assert {one.kind for one in draw} == set(faults.KINDS)


def test_a_planted_fault_changes_one_place_of_a_file(draw: list) -> None:
    for one in draw:
        source = (ROOT / one.path).read_text(encoding="utf-8")
        planted = one.planted(source)
        assert ast.dump(ast.parse(planted)) != ast.dump(ast.parse(source))
        assert planted.encode().startswith(source.encode()[: one.begin])
        assert planted.encode().endswith(source.encode()[one.end :])


def test_every_file_with_possible_faults_has_tests_and_these_exist() -> None:
    places = [one for folders in faults.AREAS.values() for one in folders if (ROOT / one).is_dir()]
    for path in (path for place in places for path in (ROOT / place).rglob("*.py")):
        for stage in covering.stages(path.relative_to(ROOT).as_posix()):
            assert all((ROOT / one.split("::")[0]).exists() for one in stage.paths)
