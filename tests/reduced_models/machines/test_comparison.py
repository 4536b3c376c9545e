"""The law next to a response, and the command that shows it; the response is a made one."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import Scene, load_scene
from granular.response import save_response
from granular.response.response import FrequencyResponse, response_dataset
from granular.shared.errors import InputError
from reduced_models.machines import compare_response, predicted_response

FREQUENCIES = [2.7, 2.85, 3.0]


def made(scene: Scene, key: str = "force") -> FrequencyResponse:
    """A response whose peak is 4 mm."""
    swing = np.array([[1e-3, 4e-3, 2e-3]])
    data = response_dataset(key, [10.0], FREQUENCIES, {"displacement": ("m", "amplitude", swing)})
    return FrequencyResponse(scene, data)


def test_errors_are_those_of_the_peaks() -> None:
    found = compare_response(made(load_scene("machine")))
    (peak,) = found.peaks
    said = predicted_response(load_scene("machine"), found.frequencies.tolist(), 10.0)
    assert peak.law == said.peak
    assert peak.law_peak_error == pytest.approx(said.peak / 4e-3 - 1.0)
    assert peak.linear == said.linear.max()
    assert found.frequencies[[0, -1]].tolist() == [2.7, 3.0]
    with pytest.raises(InputError, match="base of the machine is shaken"):
        compare_response(made(load_scene("machine"), "acceleration"))


def test_the_command_shows_the_law_or_says_why_not(tmp_path: Path, command: Callable[..., Any]) -> None:
    save_response(made(load_scene("machine")), tmp_path)
    done = command("reduced_models", "compare", "--response", str(tmp_path))
    assert done.returncode == 0
    assert done.stdout.startswith("force [N]  simulated [mm]  law [mm]  error")
    page = (tmp_path / "report.html").read_text()
    assert "The law in place of the bed" in page
    assert "linear law" in page
    save_response(made(load_scene("machine").replace(**{"grains.count": 92})), tmp_path)
    done = command("reduced_models", "compare", "--response", str(tmp_path), "--json")
    answer = json.loads(done.stdout)
    assert answer["peaks"] == []
    assert "92 grains" in answer["missing"]
    assert "92 grains" in (tmp_path / "report.html").read_text()
    done = command("reduced_models", "compare", "--response", str(tmp_path / "nothing"))
    assert done.returncode == 2
    assert "holds no response.json" in done.stderr
