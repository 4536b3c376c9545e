"""A scene and a run that were written before the packages had rooms are read and gone on with."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from granular import Scene, load_scene, load_trajectory, simulate

FORMER = Path(__file__).parents[1] / "data" / "former"


def test_the_scene_is_read() -> None:
    scene = load_scene(FORMER / "scene.toml")
    assert scene.digest() == "cd5c43af26f292c4"  # as the run has it
    assert (scene.name, scene.grains.count, scene.cell.width) == ("former", 12, 0.06)
    assert scene.effects.drag is not None
    assert scene.effects.drag.coefficient == 0.1
    assert Scene.from_plain(scene.to_plain()) == scene


def test_the_run_is_read() -> None:
    run = load_trajectory(FORMER / "run")
    data = run.dataset
    assert run.complete
    assert run.scene == load_scene(FORMER / "scene.toml")
    assert dict(data.sizes) == {"time": 21, "frame": 3, "grain": 12, "axis": 2}
    assert data["time"].values == pytest.approx(np.linspace(0.0, 0.2, 21))
    assert data["position"].values[-1, 0] == pytest.approx([8.98405e-3, 1.157414e-2], rel=1e-6)
    assert float(data["pair_energy"][-1]) == pytest.approx(1.4649127e-2, rel=1e-7)
    assert run.settings()["steps"] == 11656
    assert [(one.name, one.end, one.reason) for one in run.stages] == [("settle", 0.2, "cut")]


def test_the_run_goes_on(tmp_path: Path) -> None:
    """To a later end, as if it had never been stopped."""
    out = tmp_path / "run"
    shutil.copytree(FORMER / "run", out)
    scene = load_scene(out / "scene.toml")
    former = load_trajectory(FORMER / "run").dataset
    found = simulate(scene, out=out, resume=True, t_end=0.22, progress=False)
    whole = simulate(scene, t_end=0.22, progress=False)
    assert found.settings()["steps"] == whole.settings()["steps"] > 11656
    data = found.dataset
    assert np.array_equal(data["position"].values[: former.sizes["frame"]], former["position"])
    for name in ("position", "velocity", "kinetic_energy", "drag_loss", "left_force"):
        scale = float(np.abs(whole.dataset[name]).max())
        np.testing.assert_allclose(data[name], whole.dataset[name], rtol=0.0, atol=1e-9 * scale)
