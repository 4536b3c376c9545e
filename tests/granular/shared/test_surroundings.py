"""Commands in bad surroundings say so in one line, or do what they can."""

import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from granular import load_scene
from granular.__main__ import main
from granular.commands.console import launch

Command = Callable[..., subprocess.CompletedProcess[str]]
ROOT = Path(__file__).parents[3]
PLAIN = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


def propagate_error(done: subprocess.CompletedProcess[str]) -> str:
    assert done.stderr.startswith("error: "), done.stderr
    assert done.stderr.count("\n") == 1
    return done.stderr


def test_a_working_directory_that_was_deleted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    assert launch(main, ["show", "bed"]) == 2
    said = capsys.readouterr().err
    assert said == "error: the working directory is not there any more; change to one that is\n"


@pytest.mark.parametrize(
    ("words", "code"), [("show bed >&-", 0), ("show bed --json >&- 2>&-", 0), ("show bedd >&-", 2)]
)
def test_an_output_that_the_shell_has_closed(words: str, code: int) -> None:
    line = f"{shlex.quote(sys.executable)} -m granular {words}"
    done = subprocess.run(["sh", "-c", line], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert done.stderr.count("\n") == (code != 0)


def test_messages_stay_out_of_the_results_where_errors_have_no_output() -> None:
    line = f"{shlex.quote(sys.executable)} -m granular show bedd 2>&-"
    done = subprocess.run(["sh", "-c", line], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")


@pytest.mark.parametrize("number", ["0", "-3"])
def test_no_threads_at_all(process: Command, number: str) -> None:
    done = process("granular", "run", "single-particle", NUMBA_NUM_THREADS=number)
    assert done.returncode == 2
    assert f"NUMBA_NUM_THREADS = '{number}'; give at least 1" in propagate_error(done)


def test_threads_by_a_library_that_is_not_there(process: Command) -> None:
    words = ("granular", "run", "single-particle", "--t-end", "1e-3", "--quiet")
    done = process(*words, NUMBA_THREADING_LAYER="none such")
    assert done.returncode == 2
    assert "NUMBA_THREADING_LAYER = 'none such' cannot be used" in propagate_error(done)


def test_signs_that_the_terminal_lacks(process: Command, tmp_path: Path) -> None:
    file = tmp_path / "dämpfer.toml"
    load_scene("single-particle").replace(name="Dämpfer – 磁").save(file)
    done = process("granular", "show", str(file), **PLAIN)
    assert done.returncode == 0, done.stderr
    assert r"D\xe4mpfer \u2013 \u78c1" in done.stdout


def test_warnings_taken_for_errors(process: Command) -> None:
    words = ("granular", "run", "single-particle", "--t-end", "0.01", "--dt", "7e-4", "--quiet")
    done = process(*words, PYTHONWARNINGS="error")
    assert done.returncode == 1
    assert "warning taken for an error: records come every 0.0007 s" in propagate_error(done)
