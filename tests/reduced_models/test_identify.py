"""The way from a scene, a run or a CSV file to a report."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from granular import PistonRecord, Scene, simulate
from granular.errors import InputError
from reduced_models import identify, load_model

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    time = np.linspace(0.0, 6.0, 1200)
    height = 0.059 + 0.0012 * np.exp(-0.8 * time) * np.cos(21.8 * time)
    height += np.random.default_rng(3).normal(0.0, 3e-6, len(time))
    path = tmp_path_factory.mktemp("lab") / "lab.csv"
    PistonRecord(time, height).to_csv(path)
    return path


def test_from_csv_by_command(command: Callable, lab: Path, tmp_path: Path) -> None:
    done = command("reduced_models", "identify", str(lab), "-o", str(tmp_path / "out"), "--quiet")
    assert done.returncode == 0, done.stderr
    assert "z'' + 2*lam*z' + omega**2*z = g0" in done.stdout
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.startswith("<!doctype html>")
    assert "width=device-width" in page
    assert page.count("<svg") == 2
    assert page.count("<math") >= 4
    assert not re.search(r"(src|href)=\"http", page)
    model = load_model(tmp_path / "out" / "model.json")
    assert model.law.name == "linear"
    assert model.parameters["omega"] == pytest.approx(21.8, rel=1e-3)
    back = PistonRecord.from_csv(tmp_path / "out" / "record.csv")
    assert np.array_equal(back.height, PistonRecord.from_csv(lab).height)


def test_from_scene_with_checks(small_damper: Scene, tmp_path: Path) -> None:
    scene = small_damper.replace(
        **{"protocol.release.duration": 2.0, "protocol.drop.tolerance": "1e-3 D"}
    )
    found = identify(scene, tmp_path / "out", progress=False)
    assert (tmp_path / "out" / "run" / "checkpoint.npz").is_file()
    page = (tmp_path / "out" / "report.html").read_text()
    for words in ("The bed before and after", "Energy ledger", "Settings", "What it took"):
        assert words in page
    for figure in found.figures.values():
        assert np.isfinite(figure.value)
        assert figure.step_error is not None
        assert figure.seed_spread > 0.0
    assert found.run.complete
    assert {model.law.name for model in found.models} == {"linear", "van-der-pol-like"}
    again = identify(scene, tmp_path / "out", laws=["linear"], checks=False, progress=False)
    assert again.seconds["simulation"] < 0.5 * found.seconds["simulation"] + 1.0
    assert json.dumps(again.to_plain())


def test_from_run(small_damper: Scene, tmp_path: Path) -> None:
    scene = small_damper.replace(
        **{"protocol.drop.until": None, "protocol.drop.duration": 0.3,
           "protocol.release.duration": 1.0}
    )  # fmt: skip
    run = simulate(scene, out=tmp_path / "run", progress=False)
    found = identify(tmp_path / "run", laws=["linear"], progress=False)
    assert np.array_equal(found.record.height, run.piston().height)
    with pytest.raises(InputError, match="only a scene can be changed"):
        identify(tmp_path / "run", changes={"piston.mass": 1.0})


def test_verdict_calls_equals_equal(lab: Path) -> None:
    found = identify(lab, progress=False)
    assert found.best.law.name == "linear"
    assert "cannot tell the two apart" in found.verdict


CODE = """
import collections, sys
import jax
seen = collections.Counter()
jax.monitoring.register_event_listener(lambda name, **_: seen.update([name.split("/")[-1]]))
from reduced_models import identify
identify(sys.argv[1], progress=False)
print(seen["compile_requests_use_cache"], seen["cache_hits"])
"""


def test_second_start_compiles_nothing(lab: Path, tmp_path: Path) -> None:
    """Every request for compiled code is then served from the disk."""
    counts = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", CODE, str(lab)],
            capture_output=True,
            text=True,
            check=True,
            cwd=ROOT,
            env=os.environ | {"JAX_COMPILATION_CACHE_DIR": str(tmp_path / "jax")},
        )
        counts.append(tuple(map(int, done.stdout.split())))
    (requests, hits), again = counts
    assert requests > 5
    assert hits == 0
    assert again == (requests, requests)
