"""Damaged or malicious model files are read, or refused with a one-line error."""

import copy
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular.shared.errors import InputError
from reduced_models import ReducedModel, load_model

SAVED = Path(__file__).parents[2] / "data" / "model.json"
ODD: tuple[Any, ...] = (
    *(None, True, 0, -1, 99, 2**53 + 1, 10**400, 1e-320, 1e99, 1e308),
    *("1.0", "", "NaN", "x\x1b[2J", "z" * 10**5, "__import__('os')", '""" + 1 + """', "$\\frac{$"),
    *([], [1.0], [None, None], [2.0, 1.0], [0.1] * 300, {}, {"a": 1}, {"a": {"b": []}}),
)
CONSTANTS = ("NaN", "Infinity", "-Infinity", "1e999", "1_0", "0x1")
QUICK = 30


def places(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Return the paths of all entries in plain data."""
    items = data.items() if isinstance(data, dict) else enumerate(data)
    for key, value in items:
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from places(value, (*path, key))


def changed(data: Any, path: tuple[Any, ...], value: Any) -> Any:
    """Return plain data with another value at a path. If the value is `...`, the entry is removed."""
    found = copy.deepcopy(data)
    inner = found
    for key in path[:-1]:
        inner = inner[key]
    if value is ...:
        del inner[path[-1]]
    else:
        inner[path[-1]] = value
    return found


def cases() -> list[bytes]:
    """Return files with one odd value, one value removed or added, one flipped bit, or a truncated end."""
    text = SAVED.read_text()
    data = json.loads(text)
    spots = list(places(data))
    made = [changed(data, spot, value) for spot in spots for value in (..., *ODD)]
    made += [data | {"more": 1}, changed(data, ("quality", "more"), 1), [], 1, None, "model"]
    files = [json.dumps(one).encode() for one in made]
    for spot in spots:
        marked = json.dumps(changed(data, spot, "here"))
        files += [marked.replace('"here"', constant).encode() for constant in CONSTANTS]
    random = np.random.default_rng(0)
    for _ in range(200):
        damaged = bytearray(text.encode())
        damaged[random.integers(len(damaged))] ^= 1 << random.integers(8)
        files += [bytes(damaged), text.encode()[: random.integers(len(text))]]
    deep = [b"[" * 10**5, b'{"a":' * 10**5, b'{"format": 1, "format": 1}', b"\xff\xfe", b""]
    return [*files, *deep, b" " * (9 * 2**20), text.encode("utf-16")]


def outcome(content: bytes, path: Path) -> str:
    """Read a file, and return the outcome; a readable model must print, export and save again."""
    path.write_bytes(content)
    try:
        model = load_model(path)
    except InputError as error:
        readable = str(error).isprintable() and len(str(error)) < 1000
        return "refused" if readable else str(error)
    assert all(map(math.isfinite, model.parameters.values()))
    assert "nan" not in str(model)
    compile(model.numpy_source, "model", "exec")
    assert ReducedModel.from_plain(model.to_plain()).to_plain() == model.to_plain()
    return "read"


@pytest.mark.parametrize("count", [QUICK, pytest.param(None, marks=pytest.mark.long)])
def test_damaged_model_files_are_read_or_refused_in_one_line(count: int | None, tmp_path: Path) -> None:
    files = cases()
    if count:
        files = [files[k] for k in np.random.default_rng(1).choice(len(files), count, replace=False)]
    found = [outcome(content, tmp_path / "model.json") for content in files]
    assert set(found) == {"read", "refused"}
    assert found.count("refused") > len(files) // 2


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("format",), 99, "model.format is 99; give 1, the version that this release reads"),
        (("parameters", "lam"), None, "model.parameters.lam is None; give a number from"),
        (("parameters", "lam"), 0.0, "model.parameters.lam is 0.0; give a number above 0"),
        (("parameters", "mu"), 1.0, "model.intervals.mu is None; give a pair"),
        (("equation",), "z'' + k*z = 0", "has the parameters k, but the data contain values for lam,"),
        (("equation",), "z'' + k*z.real = 0", "'.' is not a character"),
        (("quality", "starts"), 1.5, "model.quality.starts is 1.5; give an integer"),
        (("notes",), ["a\x1b[2J"], "model.notes.0 is 'a\\x1b[2J'; give a string of printable characters"),
        (("intervals", "lam"), [2.0, 1.0], "model.intervals.lam is [2.0, 1.0]; give a pair in order"),
        (("map", "scale"), 0.0, "model.map.scale is 0.0; give another number"),
        (("quality", "residul"), 0.0, "unknown key 'residul'; did you mean 'residual'?"),
        (("initial",), ..., "'initial' is missing"),
        (("hidden",), ..., "'hidden' is missing; give the file that was saved"),
        (("quality", "noise"), ..., "model.quality: 'noise' is missing"),
        (("covariance",), [[1.0]], "model.covariance is [[1.0]]; give a row and a column for each name"),
    ],
)
def test_error_for_a_model_file_gives_the_path_of_the_invalid_entry(
    path: tuple[str, ...], value: Any, words: str, tmp_path: Path
) -> None:
    file = tmp_path / "model.json"
    file.write_text(json.dumps(changed(json.loads(SAVED.read_text()), path, value)))
    with pytest.raises(InputError) as caught:
        load_model(file)
    assert words in str(caught.value)
    assert str(caught.value).startswith(str(file))


def test_model_files_of_earlier_versions_with_an_angle_flag_are_read_with_a_unit() -> None:
    plain = json.loads(SAVED.read_text())
    assert plain["angle"] is False
    assert ReducedModel.from_plain(plain).coordinate_unit == "m"
    turning = ReducedModel.from_plain(plain | {"angle": True})
    assert (turning.coordinate_unit, turning.at_rest.coordinate_unit) == ("rad", "rad")
    assert turning.coordinate == "angle"
    assert "rad" in turning.unit_of_parameter("g0")
    again = ReducedModel.from_plain(turning.to_plain())
    assert again.to_plain() == turning.to_plain()
    with pytest.raises(InputError, match=r"model\.angle"):
        ReducedModel.from_plain(plain | {"angle": 1})


@pytest.mark.parametrize("fitted", [True, False])
def test_model_files_of_earlier_versions_with_a_separate_map_to_the_height_are_read(fitted: bool) -> None:
    """The map becomes part of the law. The motion is unchanged, and a note describes the change."""
    law = "z'' + 2*lam*z' + omega**2*z = 0"
    plain = json.loads(SAVED.read_text()) | {"law": "own", "equation": law, "mapped": True}
    plain |= {"parameters": {"lam": 0.8, "omega": 21.0}, "positive": ["lam", "omega"], "inputs": []}
    plain |= {"map": {"shift": 0.06, "scale": 0.002, "fitted": fitted}, "initial": [0.062, 0.0]}
    plain["intervals"] = {"lam": [0.7, 0.9], "omega": [20.0, 22.0]}
    if fitted:
        plain["intervals"] |= {"shift": [0.05, 0.07], "scale": [0.001, 0.003]}
    model = ReducedModel.from_plain(plain)
    assert model.law.equation == f"{law}; height = shift + scale*z"
    assert model.height_line == (0.06, 0.002)
    assert model.intervals["shift"] == ((0.05, 0.07) if fitted else (0.06, 0.06))
    assert "now part of the law" in model.notes[-1]
    time = np.linspace(0.0, 1.0, 50)
    fast = np.sqrt(21.0**2 - 0.8**2)
    swing = np.exp(-0.8 * time) * (np.cos(fast * time) + 0.8 / fast * np.sin(fast * time))
    np.testing.assert_allclose(model.simulate(time).height, 0.06 + 0.002 * swing, atol=1e-10)
    assert ReducedModel.from_plain(model.to_plain()).to_plain() == model.to_plain()
    plain["parameters"] = plain["parameters"] | {"scale": 1.0}
    with pytest.raises(InputError, match="a parameter shift or scale in addition to the equation"):
        ReducedModel.from_plain(plain)


def test_exported_python_does_not_execute_text_from_a_law(tmp_path: Path) -> None:
    """Name, source and data of a law are inside a docstring and cannot end it."""
    seen = tmp_path / "seen"
    data = json.loads(SAVED.read_text())
    hostile = f'x""" + open({str(seen)!r}, "w").close() + """\\'
    data |= {"law": hostile, "source": hostile, "provenance": {"data": hostile}}
    model = ReducedModel.from_plain(data)
    space: dict[str, Any] = {}
    exec(model.numpy_source, space)
    assert not seen.exists()
    times = np.linspace(0.0, 1.0, 50)
    np.testing.assert_allclose(space["simulate"](times), model.simulate(times).height, atol=1e-6)


def test_exported_python_renames_conflicting_parameters() -> None:
    """Parameters may have the names of the module's variables or of Python's keywords."""
    data = json.loads(SAVED.read_text())
    names = {"lam": "height", "omega": "lambda", "g0": "numpy"}
    text = data["equation"]
    for old, new in names.items():
        text = text.replace(old, new)
        for table in ("parameters", "intervals", "units"):
            data[table][new] = data[table].pop(old)
    other = ReducedModel.from_plain(data | {"equation": text, "law": "renamed", "positive": []})
    space: dict[str, Any] = {}
    exec(other.numpy_source, space)
    times = np.linspace(0.0, 1.0, 50)
    np.testing.assert_allclose(space["simulate"](times), load_model(SAVED).simulate(times).height, atol=1e-6)
