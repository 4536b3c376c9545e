"""The command ``look``: what is understood of a file, and a description that repeats it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from granular import PistonRecord
from granular.commands.console import launch
from reduced_models.__main__ import main
from reduced_models.records.record_overview import overview_of_record_file
from reduced_models.records.sources import open_source

TIME = 0.01 * np.arange(400)
HEIGHT = 59.0 + 3.0 * np.exp(-2.0 * TIME) * np.cos(21.0 * TIME)


def lab(path: Path, height: np.ndarray = HEIGHT, name: str = "dist") -> Path:
    body = [f"{t:.2f};{z:.6f};5".replace(".", ",") for t, z in zip(TIME, height, strict=True)]
    path.write_text("\n".join(["logger", f"t;{name};load", *body, ""]))
    return path


def test_figures_of_a_record(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    noisy = HEIGHT + 0.01 * random.standard_normal(len(HEIGHT))
    found = overview_of_record_file(lab(tmp_path / "lab.csv", noisy, "height_mm"))
    assert found.rate == pytest.approx(100.0)
    assert found.noise == pytest.approx(1e-5, rel=0.2)
    assert found.level is None
    assert found.gaps == 0
    assert 1.9 < found.useful < 3.2  # 3 exp(-2 t) is 0.03 at t = 2.3
    assert "decimal commas" in str(found)
    assert str(found).count("*") > 60


def test_a_sensor_that_rounds_is_recognised(tmp_path: Path) -> None:
    rounded = 0.5 * np.round(HEIGHT / 0.5)
    found = overview_of_record_file(lab(tmp_path / "lab.csv", rounded, "height [mm]"))
    assert found.level == pytest.approx(5e-4, rel=1e-6)
    assert "the sensor rounds to 0.0005 m" in str(found)


def test_gaps_are_counted(tmp_path: Path) -> None:
    PistonRecord(np.delete(TIME, slice(50, 60)), np.delete(HEIGHT, slice(50, 60))).to_csv(
        tmp_path / "gap.csv"
    )
    assert overview_of_record_file(tmp_path / "gap.csv").gaps == 1


def test_the_command_writes_a_description_that_repeats_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "runs").mkdir()
    file, description = lab(tmp_path / "runs" / "lab.csv"), tmp_path / "record.toml"
    words = ["look", str(file), "--units", "height=mm", "--flip", "--between", "0.5:2", "--json"]
    assert launch(main, [*words, "--write", str(description)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["columns"] == {"time": "t", "height": "dist"}
    assert told["samples"] == 151
    assert told["further_columns"] == ["load"]
    record = open_source(description)
    assert isinstance(record, PistonRecord)
    assert np.allclose(record.height, -1e-3 * np.round(HEIGHT[50:201], 6), rtol=1e-14)
    assert launch(main, ["look", str(description), "--plot", str(tmp_path / "look.png")]) == 0
    assert (tmp_path / "look.png").stat().st_size > 10_000
    description.write_text('file = "none.csv"\n')
    assert launch(main, ["look", str(description)]) == 2
    description.write_text('file = "runs/lab.csv"\ncolumn = 3\n')
    assert launch(main, ["look", str(description)]) == 2
    assert "did you mean 'columns'" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        ["--between", "1"],
        ["--between", "a:b"],
        ["--columns", "height"],
        ["--decimal", ":"],
        ["--units", "height=furlong"],
    ],
)
def test_bad_options_end_in_one_line(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert launch(main, ["look", str(lab(tmp_path / "lab.csv")), *words]) == 2
    assert capsys.readouterr().err.count("\n") == 1
