"""Built-in and user-defined observables, and their plots."""

import csv
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgba

from granular import Trajectory, load_scene, observables, simulate
from granular.__main__ import main
from granular.commands.console import run_command_and_return_exit_code
from granular.observables import (
    OBSERVABLES,
    Frame,
    kinetic_temperature,
    mean_pair_distance,
    observable,
    per_frame,
    plots,
    psi6,
)
from granular.observables.catalogue import observables_table
from granular.observables.frame import observable_metadata
from granular.shared.errors import InputError, SceneError
from granular.shared.plotting import SIDES

from .conftest import MakeRun, hexagonal

OWN = """
import numpy as np
from granular.observables import observable

@observable("N", "maximum force on a grain")
def maximum_force(frame):
    return np.nanmax(np.linalg.norm(frame.forces, axis=1))
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Trajectory:
    scene = load_scene("bed").replace(**{"output.frames": 0.005})
    out = tmp_path_factory.mktemp("run") / "bed"
    return simulate(scene, t_end=0.01, out=out, progress=False)


@observable("N", "maximum force on a grain")
def maximum_force(frame: Frame) -> float:
    return float(np.nanmax(np.linalg.norm(frame.forces, axis=1)))


@observable("N s", "momentum", name="momentum")
def grain_momentum(frame: Frame) -> np.ndarray:
    return frame.masses[:, None] * frame.velocities


def test_observables_are_added_to_the_dataset_with_unit_and_time(run: Trajectory) -> None:
    data = run.dataset.assign(
        maximum_force=per_frame(run, maximum_force), momentum=per_frame(run, grain_momentum)
    )
    force = np.linalg.norm(run.dataset["force"].values, axis=2)
    assert (data["maximum_force"].values == force.max(axis=1)).all()
    assert data["maximum_force"].attrs == {"units": "N", "long_name": "maximum force on a grain"}
    assert data["momentum"].dims == ("frame", "grain", "axis")
    assert (data["frame_time"] == run.dataset["frame_time"]).all()
    kinetic = (data["momentum"] * data["velocity"]).sum(("grain", "axis")).values / 2.0
    assert kinetic[-1] == pytest.approx(float(data["kinetic_energy"][-1]), rel=1e-12)


def test_built_in_observables_equal_the_functions_that_define_them(run: Trajectory) -> None:
    data, masses = run.dataset, run.scene.grains.masses()
    expected = {
        "mean_distance": [mean_pair_distance(one) for one in data["position"].values],
        "hexatic_order": [psi6(one) for one in data["position"].values],
        "temperature": [kinetic_temperature(one, masses) for one in data["velocity"].values],
    }
    for name, values in expected.items():
        np.testing.assert_allclose(per_frame(run, name), values, rtol=1e-13)
        np.testing.assert_array_equal(per_frame(run, OBSERVABLES[name]), per_frame(run, name))


def test_piston_height_is_nan_in_frames_of_a_run_without_piston() -> None:
    lone = simulate(load_scene("single-particle"), t_end=0.002, progress=False)
    found = per_frame(lone, lambda frame: frame.piston_height)
    assert np.isnan(found).all()


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (lambda frame: frame.nothing, "fails at 0 s: AttributeError"),
        (lambda frame: "words", "fails at 0 s: ValueError"),
        (lambda frame: np.zeros(3), r"the shape \(3,\); return one number, or for each grain"),
        (lambda frame: np.zeros(1 + int(frame.time > 0.0)), "values of the shape"),
    ],
)
def test_custom_observables_that_fail_or_return_wrong_shapes_are_refused(
    run: Trajectory, function: Any, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        per_frame(run, observable("1", name="mine")(function))


def test_custom_observables_with_invalid_names_or_units_are_refused(run: Trajectory) -> None:
    with pytest.raises(SceneError, match="fortnight"):
        observable("fortnight")
    with pytest.raises(InputError, match="'two words' cannot name an observable"):
        observable("N", name="two words")(lambda frame: 0.0)
    with pytest.raises(InputError, match=r"did you mean 'hexatic_order'.*--import FILE"):
        per_frame(run, "hexatic_ordre")
    with pytest.raises(InputError, match="a value for each grain"):
        observables_table(run, [grain_momentum])


def test_command_observe_writes_a_table(run: Trajectory, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(OWN)
    words = ["observe", str(run.path), "mean_distance", "maximum_force", "--quiet"]
    table = tmp_path / "table.csv"
    assert run_command_and_return_exit_code(main, [*words, "-o", str(table)]) == 2
    assert (
        run_command_and_return_exit_code(
            main, [*words, "--import", str(tmp_path / "mine.py"), "-o", str(table)]
        )
        == 0
    )
    with table.open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["time [s]", "mean_distance [m]", "maximum_force [N]"]
    again = [*words, "--import", str(tmp_path / "mine.py"), "-o", str(table)]
    assert run_command_and_return_exit_code(main, again) == 2  # existing files are not overwritten
    assert run_command_and_return_exit_code(main, [*again, "--force"]) == 0
    assert [float(row[2]) for row in rows[1:]] == per_frame(run, maximum_force).values.tolist()


def test_an_observable_can_be_the_result_that_a_study_records(run: Trajectory, tmp_path: Path) -> None:
    from granular.user_code import import_user_code_and_collect_measures

    (tmp_path / "mine.py").write_text(OWN)
    measure = import_user_code_and_collect_measures([tmp_path / "mine.py"])["maximum_force"]
    assert measure(run) == {"maximum_force": per_frame(run, maximum_force).values[-1]}
    (tmp_path / "named.py").write_text(OWN.replace("return", "return {'all': 1.0}\n    return"))
    measure = import_user_code_and_collect_measures([tmp_path / "named.py"])["maximum_force"]
    assert measure(run) == {"maximum_force.all": 1.0}


def test_an_installed_package_can_provide_observables(installed: Callable[..., None]) -> None:
    offered = {"lab": "maximum_force", "no": "no", "gone": "gone"}
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


def test_importing_observables_does_not_import_heavy_libraries() -> None:
    code = (
        "import sys, numpy, granular.observables; "
        "print([one for one in ('scipy', 'matplotlib', 'xarray', 'numba') if one in sys.modules]); "
        "from granular.observables import psi6, radial_distribution; "
        "psi6(numpy.random.default_rng(0).random((50, 2))); "
        "print([one for one in ('matplotlib', 'xarray', 'numba') if one in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["[]", "[]"]


def test_voronoi_cells_are_coloured_by_their_number_of_sides(random: np.random.Generator) -> None:
    points = random.random((150, 2)) * 0.1
    cells = observables.voronoi_cells(points)
    axes = plots.plot_cells(cells, points)
    (drawn,) = axes.collections
    assert len(drawn.get_paths()) == cells.interior.sum()
    sides = cells.sides[cells.interior]
    for name, number in (("5", 5), ("6", 6), ("7", 7)):
        alike = (drawn.get_facecolors() == to_rgba(SIDES[name])).all(axis=1)
        np.testing.assert_array_equal(alike, sides == number)
    legend = axes.get_legend()
    assert legend is not None
    named = [one.get_text() for one in legend.get_texts()]
    assert named == [list(SIDES)[k] for k in sorted(set(np.clip(sides, 4, 8) - 4))]


def test_plots_of_observables_show_the_computed_values(
    make_run: MakeRun, random: np.random.Generator
) -> None:
    frames = 0.006 * (hexagonal(9, 8) + 0.25 * random.normal(size=(3, 72, 2)))
    forces = random.normal(size=frames.shape)
    time = np.linspace(0.0, 2.0, 21)
    height = 0.1 + 0.05 * np.abs(time - 1.0)
    columns = {"time": time, "piston_height": height, "piston_force": 1.0 / height}
    run = make_run(frames, forces=forces, columns=columns)

    fractions = observables.per_frame(run, "polygons")
    hexagons = fractions.sel(label="hexagons")
    lines = plots.plot_series(fractions).get_lines()
    np.testing.assert_array_equal(lines[1].get_ydata(), hexagons)
    series = observables.per_frame(run, "hexatic_order")
    np.testing.assert_array_equal(plots.plot_series(series).get_lines()[0].get_ydata(), series)
    distances = observables.per_frame(run, "species_piston_distance")
    assert "[m]" in plots.plot_series(distances).get_ylabel()
    assert len(plots.plot_hysteresis(run).get_lines()) == 2
    profile = observables.area_fraction_by_depth(run)
    assert len(plots.plot_area_profile(profile).get_lines()) == 3
    function = observables.per_distance(run, observables.radial_distribution)
    drawn = plots.plot_correlation_function(function).get_lines()[0]
    np.testing.assert_allclose(drawn.get_xdata(), 1e3 * function["distance"])
    histograms = observables.force_distribution(observables.frame_at(run))
    assert len(plots.plot_force_distribution(histograms).patches) == 1
    cells = observables.voronoi_cells(frames[0])
    found = observables.dislocations(frames[0], cells)
    assert plots.plot_dislocations(found, frames[0]).get_xlabel() == "x [mm]"
    axes = plots.plot_order_correlation(series.values, hexagons.values)
    assert len(axes.get_lines()) == 2
    x = np.linspace(0.0, 1.0, 9)
    fit = observables.biexponential_fit(x, np.exp(x) + 0.1 * np.exp(3.0 * x))
    assert plots.plot_biexponential(fit, x, fit.values(x)).get_legend() is not None
