"""What cannot be calibrated says so in one line."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import PistonRecord, Scene, load_scene
from granular.commands.console import BAD_INPUT, launch
from granular.shared.errors import InputError, SceneError
from reduced_models import calibrate
from reduced_models.__main__ import main
from reduced_models.calibration.result import Calibration

MASS, DRAG = "piston.mass", "effects.drag.coefficient"
RECORD = PistonRecord(np.linspace(0.0, 3.0, 50), 0.06 + 1e-3 * np.sin(np.linspace(0, 60.0, 50)))


def quiet(*parameters: str, scene: Scene | None = None, **options: Any) -> Calibration:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return calibrate(
            RECORD,
            scene or load_scene("damper"),
            parameters or (MASS, DRAG),
            progress=False,
            checks=False,
            **options,
        )


def accelerations() -> PistonRecord:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return PistonRecord.from_columns({"time": RECORD.time, "acceleration": RECORD.height})


BAD: list[tuple[Callable[[], Any], str]] = [
    (lambda: quiet("piston.mas"), "did you mean 'mass'"),
    (lambda: quiet("piston.drag"), "starts from a value above 0"),
    (lambda: quiet("grains.count"), "is no quantity"),
    (lambda: quiet("effects"), "is no quantity"),
    (lambda: quiet("effects.friction.static"), "holds no effects.friction.static"),
    (lambda: quiet(MASS, MASS), "each once"),
    (lambda: quiet(seeds=1), "from 2 on"),
    (lambda: quiet(seeds=10**60), "at most 10000"),
    (lambda: quiet(confidence=1.0), "between 0 and 1"),
    (lambda: quiet(law="linaer"), "did you mean 'linear'"),
    (lambda: quiet(dt=-1.0), "above 0 s"),
    (lambda: quiet(method="euler?"), "unknown method"),
    (lambda: quiet(scene=load_scene("bed")), "moves freely"),
    (lambda: calibrate(accelerations(), load_scene("damper")), "calibrate needs heights"),
    (lambda: calibrate(RECORD, "damper"), "give a Scene"),  # type: ignore[arg-type]  # what is refused
]


@pytest.mark.parametrize(("act", "words"), BAD, ids=[row[1] for row in BAD])
def test_bad_arguments(act: Callable[[], Any], words: str) -> None:
    with pytest.raises((InputError, SceneError)) as caught:
        act()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("nothing.csv", "damper"), "there is no file"),
        (("nothing.parquet", "damper"), "there is no file"),
        (("damper", "damper"), "is a scene; give a record"),
        (("still.csv", "damper"), "a motion is needed"),
        (("grows.csv", "damper"), "unexplained, 50 % is the limit"),
        pytest.param(
            ("grows.csv", "damper", "--law", "z'' + 2*d*z' + k*z = g"),
            "damping ratio is -",
            marks=pytest.mark.long,  # quick: the same words by a made-up fit in `test_features`
        ),
        (("lab.csv", "dampr"), "did you mean 'damper'"),
        (("lab.csv", "damper", "--parameter", "piston.weight"), "unknown key 'weight'"),
        (("lab.csv", "damper", "--seeds", "1"), "from 2 on"),
        (("lab.csv", "damper", "--seeds", "few"), "invalid int value"),
        (("lab.csv", "damper", "-o", "lab.csv"), "is a file; give a directory"),
        (("lab.csv", "damper", "--set", "piston.mass=0"), "must be above 0"),
        (("lab.csv", "single-particle"), "has no piston"),
    ],
)
def test_bad_words(
    words: tuple[str, ...],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    times = np.linspace(0.0, 2.0, 2000)
    swing = 1e-3 * np.exp(-2.0 * times) * np.cos(21.8 * times)
    PistonRecord(times, 0.059 + swing).to_csv(tmp_path / "lab.csv")
    PistonRecord(times, 0.059 + swing[::-1]).to_csv(tmp_path / "grows.csv")
    PistonRecord(times, np.full(2000, 0.059)).to_csv(tmp_path / "still.csv")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    assert launch(main, ["calibrate", *words, "--quiet"]) == BAD_INPUT
    said = capsys.readouterr()
    assert said.err.startswith("error: ")
    assert said.err.count("\n") == 1
    assert message in said.err
