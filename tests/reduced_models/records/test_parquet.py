"""Every command takes a Parquet file where it takes a CSV file, and says what is wrong with one."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

from granular import PistonRecord
from granular.commands.console import BAD_INPUT, launch
from reduced_models.__main__ import main

COMMANDS = ("identify", "fit", "discover", "compare", "calibrate")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A good record, and a few Parquet files that are none."""
    time = np.linspace(0.0, 2.0, 2000)  # as in other tests: fits of one shape are compiled once
    swing = 1e-3 * np.exp(-0.8 * time) * np.cos(21.8 * time)
    noise = np.random.default_rng(3).normal(0.0, 3e-6, len(time))
    good = PistonRecord(time, 0.059 + swing + noise)
    good.to_parquet(tmp_path / "lab.parquet")
    good.to_csv(tmp_path / "lab.csv")
    good.first(2).to_parquet(tmp_path / "short.parquet")
    (tmp_path / "text.parquet").write_text("time,height\n0,1\n1,2\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)  # launch replaces it
    return tmp_path


@pytest.mark.parametrize("command", ["fit", "compare"])
def test_a_command_says_the_same_of_both(
    command: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = []
    for name in ("lab.csv", "lab.parquet"):
        assert launch(main, [command, name, "--law", "linear", "--json", "--quiet"]) == 0
        said.append(json.loads(capsys.readouterr().out.replace(f'"{name}: ', '"lab: ')))
    assert said[0] == said[1]


def test_profile_intervals_on_the_command_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["fit", "lab.parquet", "--law", "linear", "--test-fraction", "0", "--json", "--quiet"]
    found = {}
    for how in ("linear", "profile"):
        assert launch(main, [*words, "--intervals", how]) == 0
        model = json.loads(capsys.readouterr().out)["models"][0]
        assert f"intervals {how}" in model["provenance"]["fit"]
        found[how] = np.array(model["intervals"]["omega"])
    assert found["profile"] == pytest.approx(found["linear"], rel=1e-5)
    assert launch(main, [*words, "--intervals", "profil"]) == BAD_INPUT
    assert "choose from" in capsys.readouterr().err


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nothing.parquet", "there is no file"),
        ("text.parquet", "cannot be read as Parquet"),
        ("short.parquet", "at least 20"),
    ],
)
def test_bad_files_are_one_line(
    command: str, name: str, message: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [command, name, *(["damper"] if command == "calibrate" else []), "--quiet"]
    assert launch(main, words) == BAD_INPUT
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("error: ")
    assert said.err.count("\n") == 1
    assert message in said.err
