"""Records that are no good end in one line, or in a result with a warning that says why."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from granular.commands.console import BAD_INPUT, launch
from granular.shared.errors import RecordError
from reduced_models import read_record, read_releases
from reduced_models.__main__ import main

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
    "header only": ("time,height\n", "0 samples"),
    "one sample": ("time,height\n0,1\n", "1 samples"),
    "two samples": ("time,height\n0,1\n1,2\n", "at least 20 are needed"),
    "too short": (table(SWING[:15], TIME[:15]), "at least 20 are needed"),
    "short after the hold-out": (table(SWING[:25], TIME[:25]), "at least 20 are needed"),
    "constant": (table(np.full(N, 0.059)), "a motion is needed"),
    "infinite": (table(changed(7, np.inf)), "height of sample 7 (line 9) is inf"),
    "a word": (table(SWING).replace("\n0.0,", "\nzero,"), "time of sample 0 (line 2) is 'zero'"),
    "unsorted": (table(SWING, TIME[::-1]), "comes after"),
    "two samples swapped": (table(SWING, np.r_[TIME[1], TIME[0], TIME[2:]]), "comes after"),
    "a time twice": (table(SWING, np.r_[TIME[0], TIME[0], TIME[2:]]), "is there twice"),
    "wrong dimension": (table(SWING, header="time,height [kg]"), "does not fit; one of m"),
    "time in metres": (table(SWING, header="time [m],height"), "does not fit; one of s"),
    "unknown unit": (table(SWING, header="time,height [furlong]"), "unknown unit 'furlong'"),
    "no height": (table(SWING, header="time,force"), "no column 'height'; found: 'time', 'force'"),
    "an acceleration": (table(SWING, header="time,acc [m/s^2]"), "only the acceleration 'acc'"),
    "a column twice": ("time,height,height\n0,1,2\n1,2,3\n", "'height' is there twice"),
    "ragged": (table(SWING).replace("\n0.0,", "\n3,3,"), "3 values for 2 columns"),
    "decimal commas": (table(SWING).replace(".", ","), "sample 0 has 4 values for 2 columns"),
    "too many periods": (
        table(0.1 * np.cos(np.arange(40000) * 2.1), 0.01 * np.arange(40000)),
        "record.between",
    ),
    "too large": (table(1e200 * SWING), "heights up to"),
    "times too large": (table(SWING, 1e200 * TIME), "s can be computed with: check the units"),
    "no text": ("\x00\x01\x02\n", "cannot be read as text"),
}

DOUBTED = {
    "noise alone": (table(0.059 + 1e-4 * NOISE), "% of the rms swing, so the record says little"),
    "mostly noise": (table(SWING + 5e-4 * NOISE), "% of the rms swing, so the record says little"),
    "millimetres without unit": (table(1e3 * SWING), "check the units"),
    "another motion": (table(0.06 + 1e-3 * np.cos(10 * TIME + 9 * TIME**2)), "the law or the fit"),
    "blowing up": (table(0.06 + 1e-6 * np.exp(6.0 * TIME) * np.cos(21.8 * TIME)), "the law or the"),
    "a square wave": (table(0.06 + 1e-3 * np.sign(np.sin(20.0 * TIME))), "the law or the fit"),
    "a jump": (table(np.where(TIME < 1.0, 0.05, 0.06) + 1e-6 * NOISE), "the law or the fit"),
}


def said(
    text: str, folder: Path, patch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> tuple[int, str, str]:
    (folder / "bad.csv").write_text(text)
    patch.setattr(warnings, "showwarning", warnings.showwarning)  # launch replaces it
    patch.chdir(folder)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        code = launch(main, ["fit", "bad.csv", "--law", "linear", "--quiet"])
    out, complaint = capsys.readouterr()
    return code, " ".join(out.split()) if code == 0 else out, complaint


def test_clipped_samples_are_left_out_and_the_rest_is_fitted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = table(np.clip(SWING, 0.0586, 0.0594))
    code, out, complaint = said(text, tmp_path, monkeypatch, capsys)
    assert code == 0
    assert float(out.split("omega ")[1].split()[0]) == pytest.approx(21.8, rel=2e-3)
    assert "limit of the sensor (clipped)" in out
    assert "caution: " not in out + complaint


def test_an_outlier_is_left_out_and_the_rest_is_fitted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, complaint = said(table(changed(1000, 0.2)), tmp_path, monkeypatch, capsys)
    assert code == 0
    assert float(out.split("omega ")[1].split()[0]) == pytest.approx(21.8, rel=2e-3)
    assert "are left out: 1, the first at 1.50" in out
    assert "caution: " not in out + complaint


@pytest.mark.parametrize("name", REFUSED)
def test_bad_records_are_refused_in_one_line(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text, words = REFUSED[name]
    code, out, complaint = said(text, tmp_path, monkeypatch, capsys)
    assert code == BAD_INPUT
    assert out == ""
    assert complaint.startswith("error: ")
    assert complaint.count("\n") == 1
    assert words in complaint


LONG = ("noise alone", "another motion", "blowing up", "a jump")
"""Their words are those of the other three, which stay quick."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long if name in LONG else ()) for name in DOUBTED]
)
def test_doubtful_records_give_a_result_with_a_warning(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text, words = DOUBTED[name]
    code, out, complaint = said(text, tmp_path, monkeypatch, capsys)
    assert code == 0
    assert "omega " in out
    assert "caution: " in out
    assert words in out
    assert "warning: " not in complaint  # the print-out says it once
    assert "Traceback" not in complaint


def test_misspelt_options_of_reading_are_named(tmp_path: Path) -> None:
    path = tmp_path / "swing.csv"
    path.write_text(table(SWING))
    for read in (read_record, read_releases):
        with pytest.raises(RecordError, match="'betwen'"):
            read(path, betwen=(0.5, 2.0))
