"""Scenes and runs of an earlier version (9aa5be2a) load with the same meaning, and can be resumed.

`tests/data/earlier_runs` contains that version's runs of the 20-grain scenes in `scenes.toml`, with the
functions in `laws.py`.
"""

import tarfile
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import Scene, evaluate, load_scene, load_trajectory, simulate
from granular.user_code import import_user_code_and_collect_measures

pytestmark = pytest.mark.filterwarnings("ignore:.*was made with other versions")

FOLDER = Path(__file__).parents[1] / "data" / "earlier_runs"
SCENES: dict[str, dict[str, Any]] = tomllib.loads((FOLDER / "scenes.toml").read_text(encoding="utf-8"))
COMMON = {
    "grains.count": 20,
    "cell.width": "13 D",
    "piston": {"height": "6 D", "mass": "20 g"},
    "arrangement.height": "5.8 D",
    "arrangement.speed": "30 D/s",
    "arrangement.jitter": 0.05,
    "protocol": [
        {"kind": "move", "name": "press", "to": "5.9 D", "duration": 0.002},
        {"kind": "free", "name": "rise", "duration": 0.004},
    ],
    "output": {"scalars": 0.0004, "frames": 0.002},
}
STEP, PAUSE, END = 2e-5, 0.004, 0.006
"""[s]: step of the runs, when they paused, and when their protocol ends."""
ERRORS = {"discs": 2e-5, "discs-by-mesh": 3e-4}
"""Tolerances of forces over the largest, for tabulated laws; 1e-9 for others."""


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the earlier runs, with their custom laws registered."""
    import_user_code_and_collect_measures([FOLDER / "laws.py"])
    folder = tmp_path_factory.mktemp("earlier")
    with tarfile.open(FOLDER / "runs.tar.xz") as archive:
        archive.extractall(folder, filter="data")
    return folder


def scene_of(name: str) -> Scene:
    return load_scene("bed").replace(**(COMMON | SCENES[name]))


@pytest.mark.parametrize("name", SCENES)
def test_run_of_an_earlier_version_loads_with_unchanged_forces(name: str, runs: Path) -> None:
    run = load_trajectory(runs / name)
    assert run.scene == scene_of(name)
    assert float(run.dataset["time"].values[-1]) == pytest.approx(PAUSE, rel=1e-9)
    for variable in run.dataset:
        assert np.isfinite(run.dataset[variable].values).all(), variable
    if name in (
        "machine",
        "formulas",
        "list",
    ):  # which a motion, the time, or an older list of pairs also set
        return
    data = run.dataset
    known, height = data["force"].values[-1], float(data["piston_height"].values[-1])
    found = evaluate(run.scene, data["position"].values[-1], data["velocity"].values[-1], height).force
    error = ERRORS.get(name, 1e-9) * np.abs(known).max()
    np.testing.assert_allclose(found, known, rtol=0.0, atol=error)


@pytest.mark.parametrize(
    "name",
    [
        "contact",
        "friction",
        "own",
        *(pytest.param(one, marks=pytest.mark.long) for one in ("discs", "formulas")),
    ],
)
def test_run_of_an_earlier_version_is_resumed(name: str, runs: Path) -> None:
    scene = load_trajectory(runs / name).scene
    found = simulate(scene, dt=STEP, t_end=END, out=runs / name, resume=True, progress=False).dataset
    known = simulate(scene, dt=STEP, t_end=END, progress=False).dataset
    size = float(scene.grains.species[0].diameter)
    np.testing.assert_allclose(
        found["position"].values[-1], known["position"].values[-1], rtol=0.0, atol=1e-4 * size
    )
    assert found.sizes == known.sizes
