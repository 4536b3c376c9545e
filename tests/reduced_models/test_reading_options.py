"""All commands that read a record have the same options to describe it."""

import ast
import dataclasses
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import PistonRecord
from granular.records.options import ReadOptions
from granular.shared.errors import InputError
from reduced_models.__main__ import parser
from reduced_models.records import record_overview
from reduced_models.records.inputs import input_column

ROOT = Path(__file__).parents[2]
COMMANDS = {
    "look": ("look",),
    "identify": ("identify",),
    "fit": ("fit", "--law", "linear"),
    "compare": ("compare", "--law", "linear"),
    "discover": ("discover",),
    "calibrate": ("calibrate",),
}
JOBS = {
    "identify": "identification.identify.identify",
    "fit": "fitting.fit.fit",
    "compare": "identification.comparison.compare",
    "discover": "discovery.discover.discover",
    "calibrate": "calibration.calibrate.calibrate",
}
TIME = np.arange(0.0, 2.4, 0.002)
SINCE = np.maximum(TIME - 0.4, 0.0)
HEIGHT = 0.06 + 0.003 * np.exp(-1.3 * SINCE) * np.cos(25.7 * SINCE)
SAID = ("--columns", "time=clock,height=depth", "--units", "clock=ms,depth=mm", "--flip")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Return a file with meaningless names, missing units, and a coordinate that grows downwards."""
    table = np.column_stack([1e3 * TIME, -1e3 * HEIGHT, np.full_like(TIME, 5.0)])
    np.savetxt(tmp_path / "lab.csv", table, "%.6f", ",", header="clock,depth,width", comments="")
    return tmp_path / "lab.csv"


@pytest.fixture
def read(
    monkeypatch: pytest.MonkeyPatch, command: Callable[..., Any]
) -> Callable[..., tuple[PistonRecord | None, Any]]:
    """Return the record that a command passes to its function, and the messages."""

    def run(name: str, *words: str) -> tuple[PistonRecord | None, Any]:
        caught: list[Any] = []

        def job(record: Any, *_: Any, **__: Any) -> None:
            caught.append(record)
            raise InputError("caught")

        def draw(record: PistonRecord) -> str:
            caught.append(record)
            return drawn(record)

        if name == "look":
            drawn = record_overview._plot_motion_in_characters
            monkeypatch.setattr(record_overview, "_plot_motion_in_characters", draw)
        else:
            monkeypatch.setattr(f"reduced_models.{JOBS[name]}", job)
        scene = ("damper",) if name == "calibrate" else ()
        done = command("reduced_models", *COMMANDS[name], words[0], *scene, *words[1:], "--quiet")
        found = caught[0] if caught else None
        return (found[0] if isinstance(found, list) else found), done

    return run


@pytest.mark.parametrize("name", COMMANDS)
def test_all_reading_options_work_together(name: str, file: Path, read: Callable[..., Any]) -> None:
    found, done = read(name, str(file), *SAID, "--between", "300 ms:2")
    assert found.time == pytest.approx(TIME[150:1001], abs=1e-9)
    assert found.height == pytest.approx(HEIGHT[150:1001], abs=1e-8)
    assert "at rest until" not in done.stderr


@pytest.mark.parametrize("name", COMMANDS)
def test_every_column_role_is_read_with_its_calibration(
    name: str, tmp_path: Path, read: Callable[..., Any]
) -> None:
    """Each column with a role has its own unit, or a voltage with its own scale.

    Input columns are included.
    """
    shape = np.sin(3.0 * TIME)
    header = "ticks,lvdt [V],acc [g],cell [mV],table [mil],shaker [V],ch3 [mA]"
    table = np.column_stack([1e3 * TIME, HEIGHT / 2.5e-3 - 21.0, *[shape] * 5])
    np.savetxt(tmp_path / "lab.csv", table, "%.12g", ",", header=header, comments="")
    roles = "time=ticks,height=lvdt,acceleration=acc,force=cell,base_height=table,base_acceleration=shaker"
    words = ["--columns", f"{roles},valve=ch3", "--units", "time=ms", "--between", ":", "--zero", "-21 V"]
    for scale in ("2.5 mm/V", "force=10 lb/V", "base_acceleration=2 g/V"):
        words += ["--scale", scale]
    found, done = read(name, str(tmp_path / "lab.csv"), *words)
    assert found is not None, done.stderr
    assert found.time == pytest.approx(TIME, abs=1e-9)
    assert found.height == pytest.approx(HEIGHT, abs=1e-9)
    sizes = {
        "acceleration": 9.80665,
        "force": 10e-3 * 4.4482216152605,
        "base_height": 2.54e-5,
        "base_acceleration": 2.0 * 9.80665,
        "valve": 1e-3,
    }
    for role, size in sizes.items():
        assert input_column(found, role) == pytest.approx(size * shape, abs=1e-9), role


def test_options_of_the_form_name_equals_value_may_be_repeated_and_may_contain_commas(
    file: Path, read: Callable[..., Any]
) -> None:
    """The option is repeated as error messages suggest, and headings are written as in the file."""
    text = file.read_text().replace("clock,depth,width", 'clock,"depth, below",width')
    file.write_text(text)
    words = ("--columns", "time=clock", "--columns", "height=depth, below", "--units", "clock=ms")
    found, done = read("look", str(file), *words, "--units", "height=mm,width=N", "--flip", "--between", ":")
    assert found is not None, done.stderr
    assert found.height == pytest.approx(HEIGHT, abs=1e-8)


@pytest.mark.parametrize("name", COMMANDS)
def test_invalid_reading_options_are_refused(name: str, file: Path, read: Callable[..., Any]) -> None:
    for words, message in (
        (("--columns", "height=dept"), "did you mean 'depth'"),
        (("--units", "clock=ms,depth=furlong"), "furlong"),
        ((*SAID, "--flip=yes"), "ignored explicit argument"),
        (("--between", "3"), "give two times"),
    ):
        given = words if words[0] != "--units" else (*SAID[:2], *words)
        found, done = read(name, str(file), *given)
        assert (found, done.returncode, done.stderr.count("\n")) == (None, 2, 1), (words, done.stderr)
        assert message in done.stderr


@pytest.mark.parametrize("name", COMMANDS)
def test_a_hold_is_omitted_unless_times_are_given(name: str, file: Path, read: Callable[..., Any]) -> None:
    found, done = read(name, str(file), *SAID)
    assert found.time[0] == pytest.approx(0.4, abs=0.005)
    printed = done.stdout + done.stderr
    if name in ("identify", "fit", "compare", "discover"):  # whose results print the notes of their record
        assert "at rest until" not in printed
        printed = "\n".join(found.source.notes)
    assert printed.count("is at rest until 0.4") == 1
    found, done = read(name, str(file), *SAID, "--between", ":")
    assert len(found) == len(TIME)
    assert "at rest until" not in done.stdout + done.stderr


def test_a_record_for_validation_is_read_with_the_same_options(
    file: Path, monkeypatch: pytest.MonkeyPatch, command: Callable[..., Any]
) -> None:
    caught: list[Any] = []

    def job(*given: Any, **_: Any) -> None:
        caught.extend(given)
        raise InputError("caught")

    monkeypatch.setattr("reduced_models.identification.comparison.compare", job)
    command("reduced_models", "compare", str(file), "--test-records", str(file), *SAID)
    records, _, _, test_records = caught
    assert np.array_equal(records[0].height, test_records[0].height)
    assert records[0].time[0] == pytest.approx(0.4, abs=0.005)


@pytest.mark.parametrize("name", [name for name in COMMANDS if name not in ("look", "calibrate")])
def test_reading_options_are_refused_for_a_scene(name: str, read: Callable[..., Any]) -> None:
    found, done = read(name, "damper", "--units", "height=mm")
    assert (found, done.returncode) == (None, 2)
    assert "units can be given only for the file of a record, but damper is not one" in done.stderr


# What errors and pages name ------------------------------------------------------------------


def options(name: str) -> set[str]:
    """Return the options of a command."""
    (known,) = (one.choices for one in parser()._actions if isinstance(one.choices, dict))
    return {word for one in known[name]._actions for word in one.option_strings}


def test_options_recommended_in_errors_exist() -> None:
    """Errors and notes name options as in "--columns height=NAME"."""
    files = (ROOT / "granular" / "records").glob("*.py")
    nodes = (node for file in files for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))))
    texts = [one.value for one in nodes if isinstance(one, ast.Constant) and isinstance(one.value, str)]
    named = {word for text in texts for word in re.findall(r"--([a-z]+)\b", text)}
    assert {"columns", "units", "flip", "rate", "scale", "sort", "sheet", "skip", "decimal"} <= named
    fields = {field.name for field in dataclasses.fields(ReadOptions)}
    assert named <= fields
    for name in COMMANDS:
        assert {f"--{field}" for field in fields} <= options(name), name


def test_options_for_reading_records_named_in_the_guide_exist() -> None:
    """Options for a file format must exist in every command, others in a command of the page."""
    pages = ROOT / "docs" / "guide"
    word = re.compile(r"`(--[a-z-]+)")
    forms = set(word.findall((ROOT / "docs" / "reference" / "laboratory-forms.md").read_text("utf-8")))
    assert {"--columns", "--units", "--flip", "--skip"} <= forms
    for name in COMMANDS:
        assert forms <= options(name), name
    page = set(word.findall((pages / "laboratory-record.md").read_text(encoding="utf-8")))
    named = {"--between", "--mass", "--scale", "--zero", "--rate", "--sort"}
    assert named <= page <= set().union(*map(options, COMMANDS))
