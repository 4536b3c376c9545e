"""Methods of the user's own in a study: their tables go with the cases."""

from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from granular import Method, load_scene, sweep
from granular.methods import METHODS
from granular.studies.sweep import load_study

PLAIN = METHODS["position-verlet"]
TWIN = Method("twin", 2, kicks=PLAIN.kicks, drifts=PLAIN.drifts)
OTHER = Method("twin", 2, kicks=(0.5, 0.5), drifts=(1.0,))
"""Another method of the same name."""

SCENE = load_scene("single-particle")


def test_a_sweep_carries_the_table(tmp_path: Path, here: Executor) -> None:
    words: dict[str, Any] = {"dt": 1e-4, "t_end": 0.02, "progress": False, "executor": here, "out": tmp_path}
    grid = {"method": [TWIN, "position-verlet", "stormer-verlet"]}
    table = sweep(SCENE, grid, **words).table
    assert list(table["method"]) == ["twin", "position-verlet", "stormer-verlet"]
    assert not table["error"].notna().any()
    kinetic = table["kinetic_energy"]
    assert kinetic[0] == kinetic[1] != kinetic[2]
    assert sweep(SCENE, {"method": [TWIN]}, **words).reused == 1
    assert sweep(SCENE, {"method": [OTHER]}, **words).reused == 0


def test_a_study_file_may_hold_the_table(tmp_path: Path, here: Executor) -> None:
    (tmp_path / "study.toml").write_text(
        'scene = "single-particle"\ndt = 1e-4\nt_end = 0.02\n'
        "[method]\nname = 'in-a-file'\norder = 2\nkicks = [0, 1, 0]\ndrifts = [0.5, 0.5]\n"
        "[[cases]]\n'arrangement.seed' = 1\n"
        "[[cases]]\nmethod = { name = 'in-a-case', order = 2, kicks = [0.5, 0.5], drifts = [1] }\n"
    )
    study = load_study(tmp_path / "study.toml")
    found = sweep(study.pop("scene"), executor=here, progress=False, **study)
    assert [case.settings["method"]["name"] for case in found.cases] == ["in-a-file", "in-a-case"]
    assert not found.failed
