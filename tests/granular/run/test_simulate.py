"""Runs are bit-identical if they are resumed or use several threads, and for any intervals of records.

Names of variables and use of memory are also tested.
"""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import Scene, Trajectory, effect, load_scene, load_trajectory, quantity, simulate
from granular.effects.effect import EFFECTS
from granular.run.dataset import all_run_variables, check_variable_names
from granular.run.trajectory import restore_equal_times, separate_equal_times
from granular.shared.errors import InputError, Interrupted, NotAtRestError, StoreError

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def scene(small_damper: Scene) -> Scene:
    """Return a short damper run whose step does not divide any interval."""
    return small_damper.replace(
        **{
            "protocol.drop.until": None,
            "protocol.drop.duration": 0.0503,
            "protocol.release.duration": 0.05,
            "output.frames": 0.01,
        }
    )


def same(one: Trajectory, other: Trajectory) -> bool:
    return all(np.array_equal(one.dataset[name].values, other.dataset[name].values) for name in one.dataset)


def same_at_common_times(one: Trajectory, other: Trajectory) -> bool:
    """Return True if two runs are bit-identical at their common times.

    These must include all times of the shorter or coarser run, except perhaps its end.
    """
    for dimension, times in (("time", "time"), ("frame", "frame_time")):
        both = [np.unique(run.dataset[times]) for run in (one, other)]
        common, here, there = np.intersect1d(one.dataset[times], other.dataset[times], return_indices=True)
        assert len(common) >= min(map(len, both)) - 1 > 3
        for name, values in one.dataset.data_vars.items():
            if values.dims[0] == dimension:
                assert np.array_equal(values.values[here], other.dataset[name].values[there]), name
    return True


@pytest.mark.parametrize("dt", ["auto", 3e-5])
def test_a_stopped_and_resumed_run_is_bit_identical_to_an_uninterrupted_one(
    scene: Scene, tmp_path: Path, dt: float | str
) -> None:
    integer = simulate(scene, dt=dt, progress=False)
    part = simulate(scene, dt=dt, t_end=0.02345, out=tmp_path / "run", progress=False)
    assert part.complete
    assert part.dataset["time"].values[-1] == pytest.approx(0.02345)
    again = simulate(scene, dt=dt, t_end=0.0777, out=tmp_path / "run", resume=True, progress=False)
    assert again.stages[-1].name == "release"
    rest = simulate(scene, dt=dt, out=tmp_path / "run", resume=True, progress=False)
    assert rest.complete
    assert same(integer, rest)
    assert integer.stages == rest.stages
    assert same(integer, load_trajectory(tmp_path / "run"))


@pytest.mark.parametrize(
    ("dt", "output"),
    [
        ("auto", {"output.frames": 0.001}),
        ("auto", {"output.frames": 0.02, "output.record": None}),
        (2e-5, {"output.frames": 0.001}),
        # The step divides both intervals; automatic steps may differ with the interval of records.
        (2e-5, {"output.scalars": 5e-4}),
    ],
)
def test_the_intervals_of_records_and_frames_do_not_change_the_motion(
    scene: Scene, dt: float | str, output: dict[str, Any]
) -> None:
    usual = simulate(scene, dt=dt, progress=False)
    other = simulate(scene.replace(**output), dt=dt, progress=False)
    assert usual.stages == other.stages
    assert same_at_common_times(usual, other)


def test_the_frame_interval_does_not_change_the_time_at_which_a_stage_ends_at_rest(
    small_damper: Scene,
) -> None:
    soon = {"protocol.drop.window": 0.1, "protocol.drop.tolerance": 1e-4, "effects.drag.coefficient": 0.5}
    short = small_damper.replace(**soon, **{"protocol.release.duration": 0.01})
    usual, other = (simulate(short.replace(**{"output.frames": i}), progress=False) for i in (0.1, 0.02))
    assert usual.stages[0].reason == "rest"
    assert usual.stages == other.stages
    assert same_at_common_times(usual, other)


@pytest.mark.parametrize("dt", ["auto", 3e-5])
@pytest.mark.parametrize("t_end", [0.04, 0.0777, 0.2])
def test_a_longer_run_is_bit_identical_to_a_shorter_one_up_to_its_end(
    scene: Scene, dt: float | str, t_end: float
) -> None:
    usual = simulate(scene, dt=dt, progress=False)
    other = simulate(scene, dt=dt, t_end=t_end, progress=False)
    assert same_at_common_times(usual, other)


@pytest.mark.long  # quick: the direct sum, tests/physics/test_pair_sum.py
def test_runs_with_any_number_of_threads_are_bit_identical(bed: Scene) -> None:
    large = bed.replace(
        **{
            "grains.count": 1472,
            "cell.width": "120 D",
            "piston.height": "40 D",
            "arrangement.height": "38 D",
            "effects.walls": None,
            "effects.gravity": None,
            "effects.drag": None,
        }
    )
    one = simulate(large, dt=2e-5, t_end=2e-3, threads=1, progress=False)
    two = simulate(large, dt=2e-5, t_end=2e-3, threads=2, progress=False)
    assert same(one, two)


def test_variables_of_the_dataset_have_dimensions_and_units(scene: Scene, tmp_path: Path) -> None:
    run = simulate(scene, t_end=0.02, out=tmp_path / "run", progress=False)
    data = run.dataset
    assert data["position"].dims == ("frame", "grain", "axis")
    assert data["piston_height"].dims == ("time",)
    assert all("units" in data[name].attrs for name in data.variables if name not in ("grain", "axis"))
    assert data["piston_force"].attrs["units"] == "N"
    assert Scene.from_plain(__import__("tomllib").loads(data.attrs["scene"])) == scene
    versions = json.loads(data.attrs["settings"])["versions"]
    assert {"python", "numpy", "numba"} <= set(versions)
    assert list(data["axis"].values) == ["x", "y"]
    import xarray

    plain = xarray.open_zarr(tmp_path / "run" / "trajectory.zarr")
    assert plain.sizes["time"] == data.sizes["time"]


@pytest.mark.parametrize(
    ("method", "alone"),
    [
        ("pefrl", False),
        # A grain at the wall is compiled for other tests as well.
        ("adaptive-verlet", True),
        pytest.param("adaptive-verlet", False, marks=pytest.mark.long),
        # Quick: in plain Python.
        *(pytest.param("stormer-verlet+compensated", one, marks=pytest.mark.long) for one in (True, False)),
    ],
)
@pytest.mark.parametrize("cut", [0.02, 0.0123456])
def test_resumed_runs_are_bit_identical_for_every_integration_method(
    small_bed: Scene, tmp_path: Path, method: str, alone: bool, cut: float
) -> None:
    scene = small_bed
    if alone:
        scene = load_scene("single-particle").replace(**{"arrangement.positions": [["30 D", "3 D"]]})
    scene = scene.replace(**{"output.frames": 0.005})
    integer = simulate(scene, t_end=0.04, method=method, progress=False)
    for t_end in (cut, 0.04):
        part = simulate(scene, t_end=t_end, method=method, out=tmp_path / "run", resume=True, progress=False)
        assert float(part.dataset["time"][-1]) == pytest.approx(t_end, rel=1e-12)
    assert part.dataset.equals(integer.dataset)


def test_absent_effects_have_no_variables_in_the_dataset() -> None:
    """The scene has one grain above the bottom wall and no drag."""
    run = simulate(load_scene("single-particle"), t_end=5e-3, progress=False)
    assert "drag_loss" not in run.dataset
    assert "left_force" not in run.dataset
    assert "bottom_force" in run.dataset


def test_piston_record_begins_at_the_release_and_is_restored_exactly_from_its_file(
    scene: Scene, tmp_path: Path
) -> None:
    run = simulate(scene, progress=False)
    record = run.piston()
    assert record.time[0] == pytest.approx(0.0503)
    assert record.height[0] == pytest.approx(run.stage("lift").height)
    assert record.velocity[0] == 0.0
    assert len(run.piston("drop")) + len(record) <= run.dataset.sizes["time"]
    assert repr(record).startswith(f"PistonRecord of {len(record)} samples from 0.0503 to ")
    record.to_csv(tmp_path / "record.csv")
    from granular import PistonRecord

    back = PistonRecord.from_csv(tmp_path / "record.csv")
    for name in ("time", "height", "velocity", "force"):
        assert np.array_equal(getattr(record, name), getattr(back, name))


def test_dataset_of_a_run_can_be_used_with_xarray_and_pandas(scene: Scene, tmp_path: Path) -> None:
    """The piston jumps, so that two records have the same time."""
    import xarray

    run = simulate(scene, progress=False)
    data, jump = run.dataset, run.stage("lift").start
    near = data.sel(time=[jump - 1e-7, jump + 1e-7], method="nearest")
    before, behind = near["piston_height"].values
    assert behind - before == pytest.approx(run.stage("lift").height - run.stage("drop").height)
    between = data["piston_height"].interp(time=0.5 * (data["time"][3:5].values))
    assert np.isfinite(between).all()
    table = run.scalars.to_dataframe()
    assert table.index.is_unique
    assert np.array_equal(table["piston_height"], data["piston_height"])
    assert data.sel(frame=1)["frame_time"] == data["frame_time"][1]
    data.to_netcdf(tmp_path / "run.nc")
    with xarray.open_dataset(tmp_path / "run.nc") as back:
        assert np.array_equal(back["time"], data["time"])
    assert repr(run).startswith(f"Trajectory of scene {scene.name!r}, complete\n")
    assert "lift to 0.0503 s (duration)" in repr(run)
    assert "<pre>" in run._repr_html_()
    assert r"\text{  stages: drop to" in run._repr_latex_()
    assert list(run.piston().to_dataframe()) == ["time", "height", "velocity", "force"]
    assert run.piston().to_dataframe().attrs["units"]["force"] == "N"
    assert run.plot().get_ylabel() == "piston height [mm]"


def test_end_of_a_stage_at_rest_is_detected(small_damper: Scene) -> None:
    """At the end of this stage, the grains carry the weight of the piston."""
    # In more drag it rests sooner.
    scene = small_damper.replace(**{"protocol.release.duration": 0.01, "effects.drag.coefficient": 0.5})
    run = simulate(scene, progress=False)
    drop = run.stage("drop")
    assert drop.reason == "rest"
    assert drop.spread <= 1e-4 * 0.006
    at_end = run.dataset["piston_force"].values[run.dataset["stage"].values == 0][-1]
    assert at_end == pytest.approx(9.8, rel=1e-3)
    window = run.dataset.sel(time=slice(drop.end - 1.0, drop.end))["piston_height"].values
    assert np.ptp(window[1:-2]) <= 1e-4 * 0.006 * 1.0001


def test_a_bed_that_does_not_come_to_rest_raises_an_error(small_damper: Scene) -> None:
    scene = small_damper.replace(**{"protocol.drop.duration": 1.2})
    with pytest.raises(
        NotAtRestError, match=r"'drop' did not come to rest within 1\.2 s: the piston still moves at .* m/s"
    ) as caught:
        simulate(scene, progress=False)
    assert caught.value.time == pytest.approx(1.2)
    assert caught.value.trajectory.dataset["time"].values[-1] == pytest.approx(1.2, abs=2e-3)


@pytest.mark.usefixtures("interruptible")
def test_run_interrupted_by_ctrl_c_keeps_its_results(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    from granular.run.protocol_runner import ProtocolRunner

    plain, calls = ProtocolRunner.advance, []

    def advance(self: ProtocolRunner) -> None:
        plain(self)
        calls.append(1)
        if len(calls) == 12:
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(ProtocolRunner, "advance", advance)
    with pytest.raises(Interrupted) as caught:
        simulate(scene, progress=False)
    part = caught.value.trajectory
    assert not part.complete
    assert 5 < part.dataset.sizes["time"] < 104


def test_killed_run_can_be_read_and_resumed(small_damper: Scene, tmp_path: Path) -> None:
    scene = small_damper.replace(**{"protocol.drop.until": None, "protocol.drop.duration": 3.0})
    scene.save(tmp_path / "scene.toml")
    code = f"""
import granular.run.simulation as s
s.COMMIT_SECONDS = 0.0
from granular import load_scene
s.simulate(load_scene({str(tmp_path / "scene.toml")!r}), t_end=3.0, dt=1e-5,
           out={str(tmp_path / "run")!r}, progress=False)
"""
    process = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT)
    readable = 0
    for _ in range(400):
        time.sleep(0.05)
        try:
            readable = load_trajectory(tmp_path / "run").dataset.sizes["time"]
        except StoreError:
            continue
        if readable > 200:
            break
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert readable > 200
    part = load_trajectory(tmp_path / "run")
    assert not part.complete
    assert np.isfinite(part.dataset["piston_height"].values).all()
    again = simulate(scene, t_end=3.0, dt=1e-5, out=tmp_path / "run", resume=True, progress=False)
    integer = simulate(scene, t_end=3.0, dt=1e-5, progress=False)
    assert same(integer, again)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"dt": 0.0}, "above 0 s"),
        ({"dt": float("nan")}, "above 0 s"),
        ({"dt": "fast"}, "'auto'"),
        ({"dt": "auto*100"}, "above 0 and up to 8"),
        ({"method": "stormer-verlte"}, "did you mean 'stormer-verlet'"),
        ({"t_end": -1.0}, "above 0 s"),
        ({"threads": 0}, "integer from 1"),
        ({"resume": True}, "also needs the argument out"),
    ],
)
def test_invalid_arguments_of_a_simulation_are_refused(scene: Scene, arguments: dict, words: str) -> None:
    with pytest.raises(InputError, match=words.replace("(", r"\(")):
        simulate(scene, progress=False, **arguments)


def test_run_directories_are_not_overwritten(scene: Scene, tmp_path: Path) -> None:
    simulate(scene, t_end=2e-3, out=tmp_path / "run", progress=False)
    with pytest.raises(StoreError, match="holds a run"):
        simulate(scene, t_end=2e-3, out=tmp_path / "run", progress=False)
    with pytest.raises(StoreError, match="another dt"):
        simulate(scene, dt=1e-5, t_end=2e-3, out=tmp_path / "run", resume=True, progress=False)
    other = scene.replace(**{"piston.mass": 1.1})
    with pytest.raises(StoreError, match="another scene"):
        simulate(other, t_end=2e-3, out=tmp_path / "run", resume=True, progress=False)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").write_text("years of work")
    with pytest.raises(StoreError, match="not empty"):
        simulate(scene, t_end=2e-3, out=tmp_path / "full", progress=False)
    with pytest.raises(StoreError, match="holds no run"):
        load_trajectory(tmp_path / "full")


def test_two_processes_cannot_write_to_the_same_run(scene: Scene, tmp_path: Path) -> None:
    simulate(scene, t_end=2e-3, out=tmp_path / "run", progress=False)
    code = f"""
import time
from granular.run.run_directory_writer import RunDirectoryWriter
from granular import load_scene
scene = load_scene({str(tmp_path / "run" / "scene.toml")!r})
path = __import__("pathlib").Path({str(tmp_path / "run")!r})
RunDirectoryWriter(path, scene).lock()
print("held", flush=True)
time.sleep(60)
"""
    process = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"held\n"
    with pytest.raises(StoreError, match="another process is running"):
        simulate(scene, t_end=3e-3, out=tmp_path / "run", resume=True, progress=False)
    process.kill()
    process.wait()
    simulate(scene, t_end=3e-3, out=tmp_path / "run", resume=True, progress=False)


PROGRAM = """
import resource, sys
from granular import load_scene, simulate

scene = load_scene("bed").replace(**{"grains.count": 23, "cell.width": "15 D",
    "piston.height": "6 D", "arrangement.height": "5.5 D"})
UNIT = 2**20 if sys.platform == "darwin" else 2**10

def memory(times):
    for _ in range(times):
        simulate(scene, t_end=0.005, progress=False)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / UNIT

print(memory(30), memory(150))
"""


@pytest.mark.long
def test_runs_do_not_leak_memory() -> None:
    said = subprocess.run([sys.executable, "-c", PROGRAM], check=True, capture_output=True, text=True).stdout
    print(said)
    first, second = map(float, said.split())  # MB
    assert second - first < 5.0


@pytest.mark.parametrize("times", [[0.0], [0.0, 0.1, 0.2], [0.0, 0.1, 0.1, 0.2], [0.0, 0.0, 0.0, 1e-3, 1e-3]])
def test_equal_times_of_records_are_stored_as_distinct_times_and_restored_exactly(times: list[float]) -> None:
    found = separate_equal_times(np.array(times))
    assert (np.diff(found) > 0.0).all()
    assert np.abs(found - times).max() < 1e-15
    assert np.array_equal(restore_equal_times(found), times)


TAKEN = ("Kinetic", "Pair", "Piston", "Wall", "Weight")


def pull(name: str) -> type:
    """Return a custom spring class with a given name."""

    class Spring:
        """A custom spring."""

        k: float = quantity("N/m", default=1.0)

        @staticmethod
        def energy(p: Any, grain: Any, time: float) -> Any:
            return 0.5 * p.k * grain.y**2

        @staticmethod
        def force(p: Any, grain: Any, time: float) -> Any:
            return 0.0, -p.k * grain.y

    Spring.__name__ = Spring.__qualname__ = name
    return Spring


def bed_with(name: str) -> Scene:
    effect(pull(name))
    return Scene.from_plain(
        {
            "grains": {"count": 2, "species": [{"diameter": "6 mm"}]},
            "cell": {"width": "6 D"},
            "piston": {"height": "6 D", "mass": "10 g"},
            "effects": {"dipole": True, "walls": True, "gravity": True, name.lower(): True},
            "protocol": [{"name": "wait", "kind": "hold", "duration": "1 ms"}],
        }
    )


@pytest.mark.parametrize("name", TAKEN)
def test_custom_effect_cannot_have_the_name_of_a_dataset_variable(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(EFFECTS, "_own", dict(EFFECTS._own))
    scene, out = bed_with(name), tmp_path / "run"
    message = rf"effects\.{name.lower()}: its record '{name.lower()}_energy' has the same name as another"
    with pytest.raises(InputError, match=message):
        simulate(scene, dt=1e-4, progress=False, out=out)
    assert not out.exists()


def test_energy_of_a_custom_effect_is_recorded_under_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(EFFECTS, "_own", dict(EFFECTS._own))
    scene = bed_with("Tether")
    check_variable_names(scene)
    names = [variable.name for variable in all_run_variables(scene)]
    assert "tether_energy" in names
    assert len(set(names)) == len(names)
