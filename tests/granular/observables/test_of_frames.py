"""Observables of the user's own: values, units, shapes, and from files of the user's."""

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import Trajectory, load_scene, simulate
from granular.__main__ import main
from granular.commands.console import launch
from granular.observables import (
    OBSERVABLES,
    Frame,
    kinetic_temperature,
    mean_pair_distance,
    observable,
    per_frame,
    psi6,
)
from granular.observables.catalogue import observables_table
from granular.observables.frame import observable_metadata
from granular.shared.errors import InputError, SceneError

OWN = """
import numpy as np
from granular.observables import observable

@observable("N", "greatest force on a grain")
def greatest_force(frame):
    return np.nanmax(np.linalg.norm(frame.forces, axis=1))
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Trajectory:
    scene = load_scene("bed").replace(**{"output.frames": 0.005})
    out = tmp_path_factory.mktemp("run") / "bed"
    return simulate(scene, t_end=0.01, out=out, progress=False)


@observable("N", "greatest force on a grain")
def greatest_force(frame: Frame) -> float:
    return float(np.nanmax(np.linalg.norm(frame.forces, axis=1)))


@observable("N s", "momentum", name="momentum")
def grain_momentum(frame: Frame) -> np.ndarray:
    return frame.masses[:, None] * frame.velocities


def test_they_stand_in_the_dataset_with_unit_and_time(run: Trajectory) -> None:
    data = run.dataset.assign(
        greatest_force=per_frame(run, greatest_force), momentum=per_frame(run, grain_momentum)
    )
    force = np.linalg.norm(run.dataset["force"].values, axis=2)
    assert (data["greatest_force"].values == force.max(axis=1)).all()
    assert data["greatest_force"].attrs == {"units": "N", "long_name": "greatest force on a grain"}
    assert data["momentum"].dims == ("frame", "grain", "axis")
    assert (data["frame_time"] == run.dataset["frame_time"]).all()
    kinetic = (data["momentum"] * data["velocity"]).sum(("grain", "axis")).values / 2.0
    assert kinetic[-1] == pytest.approx(float(data["kinetic_energy"][-1]), rel=1e-12)


def test_those_of_the_package_are_its_functions(run: Trajectory) -> None:
    data, masses = run.dataset, run.scene.grains.masses()
    expected = {
        "mean_distance": [mean_pair_distance(one) for one in data["position"].values],
        "hexatic_order": [psi6(one) for one in data["position"].values],
        "temperature": [kinetic_temperature(one, masses) for one in data["velocity"].values],
    }
    for name, values in expected.items():
        np.testing.assert_allclose(per_frame(run, name), values, rtol=1e-13)
        np.testing.assert_array_equal(per_frame(run, OBSERVABLES[name]), per_frame(run, name))


def test_a_run_without_piston_has_no_piston_height() -> None:
    lone = simulate(load_scene("single-particle"), t_end=0.002, progress=False)
    found = per_frame(lone, lambda frame: frame.piston_height)
    assert np.isnan(found).all()


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (lambda frame: frame.nothing, "fails at 0 s: AttributeError"),
        (lambda frame: "words", "fails at 0 s: ValueError"),
        (lambda frame: np.zeros(3), r"the shape \(3,\); give a number, one a grain"),
        (lambda frame: np.zeros(1 + int(frame.time > 0.0)), "values of the shape"),
    ],
)
def test_what_is_no_value_is_refused(run: Trajectory, function: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        per_frame(run, observable("1", name="mine")(function))


def test_names_and_units_are_checked(run: Trajectory) -> None:
    with pytest.raises(SceneError, match="fortnight"):
        observable("fortnight")
    with pytest.raises(InputError, match="'two words'; give a name"):
        observable("N", name="two words")(lambda frame: 0.0)
    with pytest.raises(InputError, match=r"did you mean 'hexatic_order'.*--import FILE"):
        per_frame(run, "hexatic_ordre")
    with pytest.raises(InputError, match="a value a grain"):
        observables_table(run, [grain_momentum])


def test_the_command_writes_a_table(run: Trajectory, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(OWN)
    words = ["observe", str(run.path), "mean_distance", "greatest_force", "--quiet"]
    table = tmp_path / "table.csv"
    assert launch(main, [*words, "-o", str(table)]) == 2
    assert launch(main, [*words, "--import", str(tmp_path / "mine.py"), "-o", str(table)]) == 0
    with table.open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["time [s]", "mean_distance [m]", "greatest_force [N]"]
    again = [*words, "--import", str(tmp_path / "mine.py"), "-o", str(table)]
    assert launch(main, again) == 2  # nothing is replaced unasked
    assert launch(main, [*again, "--force"]) == 0
    assert [float(row[2]) for row in rows[1:]] == per_frame(run, greatest_force).values.tolist()


def test_an_observable_is_a_measure_of_a_study(run: Trajectory, tmp_path: Path) -> None:
    from granular.user_code import import_user_code

    (tmp_path / "mine.py").write_text(OWN)
    measure = import_user_code([tmp_path / "mine.py"])["greatest_force"]
    assert measure(run) == {"greatest_force": per_frame(run, greatest_force).values[-1]}
    (tmp_path / "named.py").write_text(OWN.replace("return", "return {'all': 1.0}\n    return"))
    measure = import_user_code([tmp_path / "named.py"])["greatest_force"]
    assert measure(run) == {"greatest_force.all": 1.0}


def test_an_installed_distribution_offers_observables(installed: Callable[..., None]) -> None:
    offered = {"lab": "greatest_force", "no": "no", "gone": "gone"}
    installed("observables", OWN + "no = 3\n", offered)
    found = observable_metadata(OBSERVABLES.find("lab"))
    assert found is not None
    assert found.unit == "N"
    with pytest.raises(
        InputError, match=r"'no' of laboratory 1\.0 is not a granular\.observables\.observable"
    ):
        OBSERVABLES.find("no")
    with pytest.raises(InputError, match=r"'gone' of laboratory 1\.0 cannot be loaded"):
        OBSERVABLES.find("gone")
