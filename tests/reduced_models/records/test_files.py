"""Files of records: overview, Parquet, and one-line errors for unusable ones."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import PistonRecord
from granular.commands.console import BAD_INPUT, run_command_and_return_exit_code
from granular.shared.errors import RecordError
from reduced_models import read_record, read_releases
from reduced_models.__main__ import main
from reduced_models.records.record_overview import overview_of_record_file
from reduced_models.records.sources import open_source
from tests.reduced_models.made import damped_cosine, noisy

N = 2000  # as in other tests: fits of one shape are compiled once
TIME = np.linspace(0.0, 3.0, N)
SWING = 0.059 + 0.0012 * np.exp(-0.8 * TIME) * np.cos(21.8 * TIME)
NOISE = np.random.default_rng(3).normal(0.0, 1.0, N)


def table(height: np.ndarray, time: np.ndarray = TIME, header: str = "time,height") -> str:
    rows = [f"{t!r},{z!r}" for t, z in zip(time.tolist(), height.tolist(), strict=True)]
    return "\n".join([header, *rows]) + "\n"


def changed(sample: int, value: float) -> np.ndarray:
    height = SWING.copy()
    height[sample] = value
    return height


REFUSED = {
    "empty": ("", "is empty"),
    "comments only": ("# lab 3\n", "is empty"),
    "header only": ("time,height\n", "no rows of numbers"),
    "one sample": ("time,height\n0,1\n", "1 samples"),
    "two samples": ("time,height\n0,1\n1,2\n", "20 or more are needed"),
    "too short": (table(SWING[:15], TIME[:15]), "20 or more are needed"),
    "short after the hold-out": (table(SWING[:25], TIME[:25]), "20 or more are needed"),
    "constant": (table(np.full(N, 0.059)), "give a record of a motion"),
    "infinite": (table(changed(7, np.inf)), "height of sample 7 (line 9) is inf"),
    "a word": (table(SWING).replace("\n0.0,", "\nzero,"), "time of sample 0 (line 2) is 'zero'"),
    "unsorted": (table(SWING, TIME[::-1]), "comes after"),
    "two samples swapped": (table(SWING, np.r_[TIME[1], TIME[0], TIME[2:]]), "comes after"),
    "a time twice": (table(SWING, np.r_[TIME[0], TIME[0], TIME[2:]]), "occurs twice"),
    "wrong dimension": (table(SWING, header="time,height [kg]"), "does not fit; a unit like m"),
    "time in metres": (table(SWING, header="time [m],height"), "does not fit; a unit like s"),
    "unknown unit": (table(SWING, header="time,height [furlong]"), "unknown unit 'furlong'"),
    "no height": (table(SWING, header="time,force"), "no column 'height'; found: 'time', 'force'"),
    "an acceleration": (table(SWING, header="time,acc [m/s^2]"), "only the acceleration 'acc'"),
    "a column twice": ("time,height,height\n0,1,2\n1,2,3\n", "the name 'height' occurs twice"),
    "ragged": (table(SWING).replace("\n0.0,", "\n3,3,"), "3 values for 2 columns"),
    "decimal commas": (table(SWING).replace(".", ","), "sample 0 has 4 values for 2 columns"),
    "too many periods": (
        table(0.1 * np.cos(np.arange(40000) * 2.1), 0.01 * np.arange(40000)),
        "record.between",
    ),
    "too large": (table(1e200 * SWING), "heights up to"),
    "times too large": (table(SWING, 1e200 * TIME), "s; check the units"),
    "no text": ("\x00\x01\x02\n", "cannot be read as text"),
}
QUESTIONABLE = {
    "mostly noise": (table(SWING + 5e-4 * NOISE), "% of the rms displacement, so the record constrains"),
    "millimetres without unit": (table(1e3 * SWING), "check the units"),
    "a square wave": (table(0.06 + 1e-3 * np.sign(np.sin(20.0 * TIME))), "the law or the fit"),
}
OMITTED = {
    "clipped samples": (table(np.clip(SWING, 0.0586, 0.0594)), "limit of the sensor (clipped)"),
    "an outlier": (table(changed(1000, 0.2)), "are omitted: 1, the first at 1.50"),
}


@pytest.fixture
def printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Callable[..., Any]
) -> Callable[[str], Any]:
    """Return the print-out of the command fit for a file with this text."""

    def run(text: str) -> Any:
        (tmp_path / "bad.csv").write_text(text)
        monkeypatch.chdir(tmp_path)
        return command("reduced_models", "fit", "bad.csv", "--law", "linear", "--quiet")

    return run


@pytest.mark.parametrize("name", OMITTED)
def test_invalid_samples_are_omitted_and_the_others_are_fitted(
    name: str, printed: Callable[[str], Any]
) -> None:
    text, words = OMITTED[name]
    done = printed(text)
    out = " ".join(done.stdout.split())
    assert done.returncode == 0
    assert float(out.split("omega ")[1].split()[0]) == pytest.approx(21.8, rel=2e-3)
    assert words in out
    assert "caution: " not in out + done.stderr


@pytest.mark.parametrize("name", REFUSED)
def test_unusable_records_are_refused_in_one_line(name: str, printed: Callable[[str], Any]) -> None:
    text, words = REFUSED[name]
    done = printed(text)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (BAD_INPUT, "", 1)
    assert done.stderr.startswith("error: ")
    assert words in done.stderr


@pytest.mark.parametrize("name", QUESTIONABLE)
def test_questionable_records_give_a_result_and_a_warning(name: str, printed: Callable[[str], Any]) -> None:
    text, words = QUESTIONABLE[name]
    done = printed(text)
    out = " ".join(done.stdout.split())
    assert done.returncode == 0
    assert "omega " in out
    assert "caution: " in out
    assert words in out
    assert "warning: " not in done.stderr  # only in the print-out
    assert "Traceback" not in done.stderr


def test_misspelt_reading_options_are_reported(tmp_path: Path) -> None:
    path = tmp_path / "swing.csv"
    path.write_text(table(SWING))
    for read in (read_record, read_releases):
        with pytest.raises(RecordError, match="'betwen'"):
            read(path, betwen=(0.5, 2.0))


LOOK_TIME = 0.01 * np.arange(400)
HEIGHT = 59.0 + 3.0 * np.exp(-2.0 * LOOK_TIME) * np.cos(21.0 * LOOK_TIME)


def lab(path: Path, height: np.ndarray = HEIGHT, name: str = "dist") -> Path:
    body = [f"{t:.2f};{z:.6f};5".replace(".", ",") for t, z in zip(LOOK_TIME, height, strict=True)]
    path.write_text("\n".join(["logger", f"t;{name};load", *body, ""]))
    return path


def test_the_overview_of_a_record_gives_its_main_figures(tmp_path: Path) -> None:
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


def test_rounding_by_a_sensor_is_recognised(tmp_path: Path) -> None:
    rounded = 0.5 * np.round(HEIGHT / 0.5)
    found = overview_of_record_file(lab(tmp_path / "lab.csv", rounded, "height [mm]"))
    assert found.level == pytest.approx(5e-4, rel=1e-6)
    assert "the sensor rounds to 0.0005 m" in str(found)


def test_gaps_of_a_record_are_counted(tmp_path: Path) -> None:
    PistonRecord(np.delete(LOOK_TIME, slice(50, 60)), np.delete(HEIGHT, slice(50, 60))).to_csv(
        tmp_path / "gap.csv"
    )
    assert overview_of_record_file(tmp_path / "gap.csv").gaps == 1


def test_description_file_written_by_the_command_look_gives_the_same_record(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "runs").mkdir()
    file, description = lab(tmp_path / "runs" / "lab.csv"), tmp_path / "record.toml"
    words = ["look", str(file), "--units", "height=mm", "--flip", "--between", "0.5:2", "--json"]
    assert run_command_and_return_exit_code(main, [*words, "--write", str(description)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["columns"] == {"time": "t", "height": "dist"}
    assert told["samples"] == 151
    assert told["further_columns"] == ["load"]
    record = open_source(description)
    assert isinstance(record, PistonRecord)
    assert np.allclose(record.height, -1e-3 * np.round(HEIGHT[50:201], 6), rtol=1e-14)
    assert (
        run_command_and_return_exit_code(
            main, ["look", str(description), "--plot", str(tmp_path / "look.png")]
        )
        == 0
    )
    assert (tmp_path / "look.png").stat().st_size > 10_000
    description.write_text('file = "none.csv"\n')
    assert run_command_and_return_exit_code(main, ["look", str(description)]) == 2
    description.write_text('file = "runs/lab.csv"\ncolumn = 3\n')
    assert run_command_and_return_exit_code(main, ["look", str(description)]) == 2
    assert "did you mean 'columns'" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", ["--between 1", "--between a:b", "--columns height", "--decimal :", "--units height=furlong"]
)
def test_wrong_reading_options_give_a_one_line_error(
    words: str, tmp_path: Path, command: Callable[..., Any]
) -> None:
    done = command("reduced_models", "look", str(lab(tmp_path / "lab.csv")), *words.split())
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)


COMMANDS = ("identify", "fit", "discover", "compare", "calibrate")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Return a folder with a usable record and some unusable Parquet files."""
    time = np.linspace(0.0, 2.0, 2000)  # as in other tests: fits of one shape are compiled once
    good = noisy(time, 0.059 + damped_cosine(time), 3e-6, 3)
    good.to_parquet(tmp_path / "lab.parquet")
    good.to_csv(tmp_path / "lab.csv")
    good.first(2).to_parquet(tmp_path / "short.parquet")
    (tmp_path / "text.parquet").write_text("time,height\n0,1\n1,2\n")
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", ["fit", "compare"])
@pytest.mark.usefixtures("folder")
def test_csv_and_parquet_files_give_the_same_printed_text(name: str, command: Callable[..., Any]) -> None:
    printed = []
    for file in ("lab.csv", "lab.parquet"):
        done = command("reduced_models", name, file, "--law", "linear", "--json", "--quiet")
        assert done.returncode == 0
        printed.append(json.loads(done.stdout.replace(f'"{file}: ', '"lab: ')))
    assert printed[0] == printed[1]


@pytest.mark.usefixtures("folder")
def test_profile_intervals_can_be_requested_on_the_command_line(command: Callable[..., Any]) -> None:
    words = ("reduced_models", "fit", "lab.parquet", "--law", "linear", "--test-fraction", "0", "--json")
    found = {}
    for how in ("linear", "profile"):
        (model,) = json.loads(command(*words, "--intervals", how).stdout)["models"]
        assert f"intervals {how}" in model["provenance"]["fit"]
        found[how] = model["intervals"]["omega"]
    assert found["profile"] == pytest.approx(found["linear"], rel=1e-5)
    done = command(*words, "--intervals", "profil")
    assert done.returncode == BAD_INPUT
    assert "choose from" in done.stderr


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize(
    ("file", "message"),
    [
        ("nothing.parquet", "does not exist"),
        ("text.parquet", "cannot be read as Parquet"),
        ("short.parquet", "20 or more"),
    ],
)
def test_unusable_parquet_files_give_a_one_line_error(
    name: str, file: str, message: str, command: Callable[..., Any]
) -> None:
    scene = ("damper",) if name == "calibrate" else ()
    done = command("reduced_models", name, file, *scene, "--quiet")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (BAD_INPUT, "", 1)
    assert done.stderr.startswith("error: ")
    assert message in done.stderr
