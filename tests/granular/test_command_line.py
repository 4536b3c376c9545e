"""The command lines: what they print, exit codes, one-line errors, and no second compilation."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

Command = Callable[..., "subprocess.CompletedProcess[str]"]  # noqa: F821

SMALL = (
    "--set", "grains.count=23", "--set", "cell.width=15 D", "--set", "piston.height=6 D",
    "--set", "arrangement.height=5.5 D",
)  # fmt: skip


def test_scenes_and_show(command: Command) -> None:
    done = command("granular", "scenes", "--json")
    assert done.returncode == 0
    assert {"bed", "damper", "single-particle"} <= set(json.loads(done.stdout))
    done = command("granular", "show", "damper", "--set", "piston.mass=6.5")
    assert done.returncode == 0
    assert "6.5 kg" in done.stdout
    assert "packing fraction 0.2409" in done.stdout


def test_run_writes_and_resumes(command: Command, tmp_path: Path) -> None:
    out = str(tmp_path / "run")
    first = command("granular", "run", "bed", *SMALL, "--t-end", "0.01", "-o", out, "--json")
    assert first.returncode == 0, first.stderr
    assert json.loads(first.stdout)["time"] == pytest.approx(0.01)
    assert "settle" in first.stderr
    again = command(
        "granular", "run", "bed", *SMALL, "--t-end", "0.02", "-o", out, "--resume", "--quiet"
    )
    assert again.returncode == 0
    assert "0 to 0.02 s" in again.stdout
    assert again.stderr == ""


def test_help_is_there(command: Command) -> None:
    for words in (("granular", "run"), ("reduced_models", "identify")):
        done = command(*words, "--help")
        assert done.returncode == 0
        assert "--set" in done.stdout


BAD = [
    (("granular",), "required: COMMAND"),
    (("granular", "fly"), "invalid choice: 'fly'"),
    (("granular", "run"), "required: scene"),
    (("granular", "run", "dampr"), "did you mean 'damper'"),
    (("granular", "run", "missing.toml"), "there is no scene file"),
    (("granular", "run", "bed", "--sett", "a=b"), "unrecognized arguments"),
    (("granular", "run", "bed", "--set", "grains.count"), "is not KEY=VALUE"),
    (("granular", "run", "bed", "--set", "grains.cuont=3"), "did you mean 'count'"),
    (("granular", "run", "bed", "--set", "cell.width=3 kg"), "a quantity in m is wanted"),
    (("granular", "run", "bed", "--dt", "-1"), "above 0 s"),
    (("granular", "run", "bed", "--dt", "soon"), "is not a quantity"),
    (("granular", "run", "bed", "--dt", "1 mm"), "a quantity in s is wanted"),
    (("granular", "run", "bed", "--method", "euler?"), "unknown method"),
    (("granular", "run", "bed", "--threads", "many"), "invalid int value"),
    (("granular", "run", "bed", "--threads", "0"), "whole number from 1"),
    (("granular", "run", "bed", "--t-end", "0"), "above 0 s"),
    (("granular", "run", "bed", "--resume"), "needs out"),
    (("granular", "run", "bed", "-o", "/proc/nowhere/run"), "cannot be made"),
    (("granular", "show", "bed", "--set", "piston.height=0"), "must be above 0 m"),
    (("reduced_models", "identify"), "required: source"),
    (("reduced_models", "identify", "nothing.csv"), "there is no file"),
    (("reduced_models", "identify", "single-particle"), "has no piston"),
    (("reduced_models", "identify", "damper", "--law", "linaer"), "did you mean 'linear'"),
    (("reduced_models", "identify", "damper", "--starts", "0"), "whole number from 1"),
]


@pytest.mark.parametrize(("words", "message"), BAD, ids=[" ".join(one[0][1:]) for one in BAD])
def test_bad_input_is_one_line_and_exit_code_2(
    command: Command, words: tuple[str, ...], message: str
) -> None:
    done = command(*words)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert message in done.stderr


def test_failed_run_is_one_line_and_exit_code_1(command: Command) -> None:
    done = command("granular", "run", "bed", *SMALL, "--dt", "2e-3", "--quiet")
    assert done.returncode == 1
    lines = [line for line in done.stderr.splitlines() if not line.startswith("warning: ")]
    assert len(lines) == 1
    assert lines[0].startswith("error: step ")
    assert "shorten dt" in lines[0]


def test_second_start_compiles_nothing(command: Command, tmp_path: Path) -> None:
    words = ("granular", "run", "bed", *SMALL, "--t-end", "0.002", "--quiet")
    caches = {"NUMBA_CACHE_DIR": str(tmp_path / "numba")}

    def compiled() -> dict[str, int]:
        return {str(one): one.stat().st_mtime_ns for one in (tmp_path / "numba").rglob("*.nb*")}

    assert command(*words, **caches).returncode == 0
    first = compiled()
    assert first
    assert command(*words, **caches).returncode == 0
    assert compiled() == first
