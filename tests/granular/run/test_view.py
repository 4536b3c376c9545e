"""A run as a page that moves holds what the run does, and nothing that breaks the page."""

from __future__ import annotations

import base64
import dataclasses
import html
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import load_scene, simulate
from granular.run import animation_page
from granular.run.trajectory import Trajectory
from granular.shared.errors import InputError
from granular.shared.html_pages import InteractivePage


def data_of(page: InteractivePage) -> dict[str, Any]:
    (text,) = re.findall(r'<script id="data" type="application/json">(.*)</script>', page.page)
    return json.loads(text)


def numbers(packed: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(packed), dtype="<f4")


def test_the_page_holds_the_run(run: Trajectory, tmp_path: Path) -> None:
    page = run.animate()
    data = data_of(page)
    place = run.dataset["position"].values.astype("<f4")
    np.testing.assert_array_equal(numbers(data["position"]).reshape(place.shape), place)
    assert data["frames"] == list(run.dataset["frame_time"].values)
    np.testing.assert_allclose(data["curve"], run.dataset["piston_height"])
    slope = (0.02 - 0.03) / run.dataset["time"].values[-1]
    np.testing.assert_allclose(data["phase"], slope)  # it was not recorded
    page.save(tmp_path / "view.html")
    assert (tmp_path / "view.html").read_text(encoding="utf-8") == page.page
    inside = re.findall(r'srcdoc="([^"]*)"', page._repr_html_())
    assert html.unescape(inside[0]) == page.page
    assert "view.html" in repr(page)


def test_names_cannot_leave_their_place(run: Trajectory) -> None:
    name = "</script><b>&"
    stage = dataclasses.replace(run.stages[0], name=name)
    named = dataclasses.replace(run, scene=run.scene.replace(name=name), stages=(stage,))
    page = named.animate()
    assert "<b>" not in page.page
    assert data_of(page)["stages"][0]["name"] == name


def test_of_many_frames_some_are_held(run: Trajectory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(animation_page, "MOST_VALUES", 30 * 7 * 4)
    data = data_of(run.animate())
    assert data["frames"] == list(run.dataset["frame_time"].values[::3])
    assert len(numbers(data["velocity"])) == 30 * 7 * 2


def test_without_a_piston_the_energy_is_shown() -> None:
    run = simulate(load_scene("single-particle"), t_end=0.3, progress=False)
    data = data_of(run.animate())
    assert data["phase"] is None
    np.testing.assert_allclose(data["curve"], run.dataset["kinetic_energy"])
    assert data["top"] > 0.2
    with pytest.raises(InputError, match="no frames"):
        dataclasses.replace(run, dataset=run.dataset.isel(frame=slice(0, 0))).animate()
