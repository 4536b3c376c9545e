"""Commands: options derived from function signatures, progress display, and one-line errors for a
faulty environment.
"""

import argparse
import dataclasses
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import pytest

from granular import load_scene
from granular.__main__ import main
from granular.commands.console import (
    Parser,
    Program,
    command,
    command_registry,
    run_command_and_return_exit_code,
)
from granular.commands.signature import Option, Seconds, add_options, collect_arguments_from_options
from granular.shared.errors import InputError
from granular.shared.progress_bars import progress_bar, stage_reporter

Command = Callable[..., subprocess.CompletedProcess[str]]
ROOT = Path(__file__).parents[3]
PLAIN = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


def propagate_error(done: subprocess.CompletedProcess[str]) -> str:
    assert done.stderr.startswith("error: "), done.stderr
    assert done.stderr.count("\n") == 1
    return done.stderr


def test_command_in_a_deleted_working_directory_reports_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    assert run_command_and_return_exit_code(main, ["show", "bed"]) == 2
    said = capsys.readouterr().err
    assert said == "error: the working directory no longer exists; change to another directory\n"


@pytest.mark.parametrize(
    ("words", "code"), [("show bed >&-", 0), ("show bed --json >&- 2>&-", 0), ("show bedd >&-", 2)]
)
def test_command_with_a_closed_output_stream_does_not_fail(words: str, code: int) -> None:
    line = f"{shlex.quote(sys.executable)} -m granular {words}"
    done = subprocess.run(["sh", "-c", line], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert done.stderr.count("\n") == (code != 0)


def test_messages_are_not_printed_among_results_if_stderr_is_closed() -> None:
    line = f"{shlex.quote(sys.executable)} -m granular show bedd 2>&-"
    done = subprocess.run(["sh", "-c", line], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")


@pytest.mark.parametrize("number", ["0", "-3"])
def test_environment_with_zero_numba_threads_is_refused(process: Command, number: str) -> None:
    done = process("granular", "run", "single-particle", NUMBA_NUM_THREADS=number)
    assert done.returncode == 2
    assert (
        f"NUMBA_NUM_THREADS = '{number}' is not a number of threads; set it to 1 or more"
        in propagate_error(done)
    )


def test_missing_threading_layer_of_numba_is_reported(process: Command) -> None:
    words = ("granular", "run", "single-particle", "--t-end", "1e-3", "--quiet")
    done = process(*words, NUMBA_THREADING_LAYER="none such")
    assert done.returncode == 2
    assert "NUMBA_THREADING_LAYER = 'none such' cannot be used" in propagate_error(done)


def test_output_of_a_command_escapes_characters_that_the_terminal_lacks(
    process: Command, tmp_path: Path
) -> None:
    file = tmp_path / "dämpfer.toml"
    load_scene("single-particle").replace(name="Dämpfer – 磁").save(file)
    done = process("granular", "show", str(file), **PLAIN)
    assert done.returncode == 0, done.stderr
    assert r"D\xe4mpfer \u2013 \u78c1" in done.stdout


def test_warnings_that_python_treats_as_errors_are_reported_in_one_line(process: Command) -> None:
    words = ("granular", "run", "single-particle", "--t-end", "0.01", "--dt", "7e-4", "--quiet")
    done = process(*words, PYTHONWARNINGS="error")
    assert done.returncode == 1
    assert "warning treated as an error: records come every 0.0007 s" in propagate_error(done)


@dataclasses.dataclass(frozen=True)
class Group:
    """A group of options."""

    title: ClassVar[str] = "options of a group"
    loud: Annotated[bool, Option("print all")] = False
    names: Annotated[tuple[str, ...], Option("name (repeatable)", "NAME", name="--name")] = ()


def carry_out(
    scene: Annotated[str, Option("a scene", "SCENE")],
    files: Annotated[tuple[str, ...], Option("files", "FILE")] = (),
    *,
    out: Annotated[str, Option("directory", "DIR", "-o")],
    t_end: Annotated[Seconds | None, Option("end", "T")] = None,
    times: Annotated[tuple[Seconds, ...], Option("times", "T", name="--time")] = (),
    count: Annotated[int, Option("how many")] = 3,
    reach: Annotated[float | None, Option("reach", "A")] = None,
    kind: Annotated[Literal["a", "b"], Option("kind")] = "a",
    drift: Annotated[bool | None, Option("drift or not")] = None,
    warm: Annotated[tuple[str, ...] | None, Option("scenes", nargs="*")] = None,
    group: Group,
) -> None:
    """Carry out."""


def parsed(*words: str) -> dict[str, Any]:
    parser = Parser(prog="p")
    add_options(parser, carry_out)
    return collect_arguments_from_options(carry_out, parser.parse_args(words))


def test_defaults_of_command_options_are_the_defaults_of_the_function() -> None:
    found = parsed("bed", "-o", "here")
    assert found == {
        "scene": "bed",
        "files": (),
        "out": "here",
        "t_end": None,
        "times": (),
        "count": 3,
        "reach": None,
        "kind": "a",
        "drift": None,
        "warm": None,
        "group": Group(),
    }


def test_values_of_command_options_are_converted_to_the_types_in_the_signature() -> None:
    words = (
        "bed a.csv b.csv --out o --t-end 500ms --time 1ms --time 2s --count 5 --reach 0.5 --kind b --no-drift"
    )
    found = parsed(*words.split(), "--warm", "--loud", "--name", "x", "--name", "y")
    assert found["files"] == ("a.csv", "b.csv")
    assert found["t_end"] == 0.5
    assert found["times"] == (0.001, 2.0)
    assert found["reach"] == 0.5
    assert (found["count"], found["kind"], found["drift"], found["warm"]) == (5, "b", False, ())
    assert found["group"] == Group(True, ("x", "y"))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("bed", "required: -o/--out"),
        ("bed -o o --t-end 5kg", "argument --t-end: .*kg"),
        ("bed -o o --count x", "argument --count: invalid int"),
        ("bed -o o --kind c", "argument --kind: invalid choice"),
    ],
)
def test_error_for_an_invalid_value_names_the_command_option(words: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parsed(*words.split())


def test_help_of_a_command_contains_the_descriptions_in_the_signature() -> None:
    program = Program("p", "d", "e", command_registry("", {"carry-out": command("x")(carry_out)}))
    parser = program.parser().parsers["carry-out"]
    text = " ".join(parser.format_help().split())
    assert "options of a group: --loud print all --name NAME name (repeatable)" in text
    assert "-o DIR, --out DIR directory" in text or "-o, --out DIR directory" in text
    assert program.parser().commands == {"carry-out": "carry out"}
    assert isinstance(parser, argparse.ArgumentParser)


def test_progress_in_a_log_file_has_a_line_at_the_start_and_one_at_the_end(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    for _ in progress_bar(iterable=range(500), desc="cases", bar_format="{desc} {bar:20} {n_fmt}"):
        pass
    said = capsys.readouterr().err
    assert said == "cases 0\ncases 500\n"


def test_progress_lines_in_a_log_file_are_limited_in_rate(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    with progress_bar(desc="cases", total=100) as bar:
        for k in range(100):
            bar.set_postfix_str(f"at {k}")
            bar.set_description_str(f"cases {k}")
            bar.update()
    assert capsys.readouterr().err.splitlines() == [
        "cases: 0 of 100 [00:00]",
        "cases 99: 100 of 100, at 99 [00:00]",
    ]


def test_progress_in_a_log_file_has_one_line_per_minute(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = [0.0]
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    monkeypatch.setattr("granular.shared.progress_bars.time.monotonic", lambda: clock[0])
    with stage_reporter("search", wanted=True) as now:
        for k in range(200):
            clock[0] = float(k)
            now(f"at {k}")
    shown = [line.partition(" [")[0] for line in capsys.readouterr().err.splitlines()]
    assert shown == ["search", "search: at 60", "search: at 120", "search: at 180", "search: at 199"]


def test_progress_in_a_terminal_is_shown_as_a_bar(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    for _ in progress_bar(iterable=range(5), desc="cases", ascii=True):
        pass
    said = capsys.readouterr().err
    assert "\r" in said
    assert "cases: 100%|###" in said


def test_disabled_progress_prints_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    for _ in progress_bar(iterable=range(5), desc="cases", wanted=False):
        pass
    assert capsys.readouterr().err == ""
