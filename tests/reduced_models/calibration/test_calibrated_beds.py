"""Calibration of scenes by records of simulated beds, and refused arguments."""

import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import PistonRecord, Scene, damper, load_scene, simulate
from granular.commands.console import BAD_INPUT, INTERRUPTED
from granular.shared.errors import InputError, SceneError
from granular.studies.cases import Case, CaseOutcome
from reduced_models import calibrate
from reduced_models.calibration.result import Calibration
from tests.reduced_models.made import damped_cosine

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")

MASS, DRAG, REMANENCE = "piston.mass", "effects.drag.coefficient", "grains.remanence"


def spring_oscillation(mass: float, drag: float, seed: int, slower: float = 1.0) -> PistonRecord:
    """Return the oscillation of a piston on springs that differ slightly from bed to bed."""
    time = np.linspace(0.0, 2.0, 2000)
    random = np.random.default_rng(seed)
    rest = 0.059 * (7.5 / mass) ** 0.35 * (1.0 + 1e-3 * random.normal())
    omega = 21.8 * (7.5 / mass) ** 0.1 * (1.0 + 1e-3 * random.normal()) / slower
    decay = 4.0 * drag / mass * 7.5 * (1.0 + 1e-2 * random.normal())
    height = rest + 1e-3 * np.exp(-decay * time) * np.cos(omega * time)
    return PistonRecord(time, height + random.normal(0.0, 3e-6, len(time)))


class Springs(Executor):
    """Executor that answers a case by the oscillation for its mass and drag instead of simulating it."""

    def submit(self, _: Callable[..., Any], case: Case, *__: Any) -> Future[Any]:
        scene, future = case.scene, Future[Any]()
        drag = scene.effects.drag.coefficient
        columns = spring_oscillation(scene.piston.mass, drag, scene.arrangement.seed).columns
        figures = {name: values.tolist() for name, values in columns.items()}
        future.set_result(CaseOutcome(figures))
        return future


def test_calibration_runs_its_simulations_on_the_given_executor_and_saves_its_results(tmp_path: Path) -> None:
    """Discrepancies between the calibrated scene and the record are noted."""
    record, options = spring_oscillation(7.0, 0.11, 100, slower=1.05), {"checks": False, "progress": False}
    with pytest.warns(UserWarning, match="the calibrated values do not reproduce the record's period"):
        found = calibrate(record, load_scene("damper"), seeds=2, executor=Springs(), out=tmp_path, **options)
    assert found.notes
    assert found.values[DRAG] == pytest.approx(0.11, rel=0.1)
    assert (tmp_path / "report.html").is_file()


def small(**changes: Any) -> Scene:
    """Return a scene of 23 grains that soon come to rest."""
    made = {"grains.count": 23, "cell.width": "15 D", "piston.height": "6 D", "piston.mass": 1.0}
    made |= {"arrangement.height": "5.5 D", DRAG: 0.5, "protocol.release.duration": 2.0}
    return load_scene("damper").replace(**made | changes)


def lab_record(scene: Scene, seed: int = 1, *, force: bool = False) -> PistonRecord:
    """Return the record of a run, with noise of 1 % of its rms displacement."""
    record = simulate(scene, progress=False).piston()
    noise = np.random.default_rng(seed).normal(0.0, 0.01 * record.height.std(), len(record))
    return PistonRecord(record.time, record.height + noise, force=record.force if force else None)


@pytest.mark.long
@pytest.mark.usefixtures("interruptible")
def test_an_interrupted_calibration_can_be_continued(tmp_path: Path) -> None:
    """Ctrl-C ends it with two lines. The same command then continues without repeating a simulation."""
    truth = {MASS: 1.15, DRAG: 0.42, "arrangement.seed": 11}
    lab_record(small(**truth)).to_csv(tmp_path / "lab.csv")
    small().save(tmp_path / "start.toml")
    options = ("--seeds", "2", "-o", "out", "--no-checks", "--quiet")
    words = (sys.executable, "-m", "reduced_models", "calibrate", "lab.csv", "start.toml", *options)

    def kept() -> dict[Path, int]:
        cases = (tmp_path / "out" / "simulations" / "cases").glob("[!.]*.json")
        return {path: path.stat().st_mtime_ns for path in cases}

    first = subprocess.Popen(words, cwd=tmp_path, stderr=subprocess.PIPE, text=True, start_new_session=True)
    while first.poll() is None and len(kept()) < 2:
        time.sleep(0.05)
    os.killpg(first.pid, signal.SIGINT)
    _, said = first.communicate(timeout=120)
    assert first.returncode == INTERRUPTED
    assert "Traceback" not in said
    assert "finished simulations are kept in out; the same command goes on" in said
    done = kept()
    subprocess.run(words, cwd=tmp_path, check=True, capture_output=True)
    again = kept()
    assert len(again) > len(done) >= 2
    assert all(again[path] == when for path, when in done.items())


@pytest.mark.long
def test_calibration_recovers_mass_and_drag_of_a_bed(tmp_path: Path) -> None:
    """The bed has 92 grains.

    The true values lie within the intervals from three records with different packings.
    """
    start = damper(count=92)
    truth = {MASS: 0.85 * start.piston.mass, DRAG: 0.14}
    for seed in (101, 102, 103):
        scene = start.replace(**truth, **{"arrangement.seed": seed})
        found = calibrate(lab_record(scene, seed), start, out=tmp_path, progress=False)
        for one in found.parameters:
            assert one.interval[0] < truth[one.key] < one.interval[1]
            assert one.value == pytest.approx(truth[one.key], rel=0.1)
            assert one.step < 0.5 * math.log(one.interval[1] / one.interval[0])
        assert found.simulations <= 40


@pytest.mark.long
def test_with_a_measured_force_calibration_determines_remanence_mass_and_drag(tmp_path: Path) -> None:
    """The bed has 92 grains."""
    start = damper(count=92)
    truth = {MASS: 0.9 * start.piston.mass, DRAG: 0.12, REMANENCE: 1.24}
    record = lab_record(start.replace(**truth, **{"arrangement.seed": 104}), force=True)
    keys = tuple(truth)
    found = calibrate(record, start, keys, out=tmp_path, progress=False)
    assert found.undetermined == ()
    for one in found.parameters:
        assert one.interval[0] < truth[one.key] < one.interval[1]
    sharp = math.log(found.intervals[REMANENCE][1] / found.intervals[REMANENCE][0])
    silent = PistonRecord(record.time, record.height)
    found = calibrate(silent, start, keys, out=tmp_path, progress=False, checks=False)
    for one in found.parameters:
        assert one.interval[0] < truth[one.key] < one.interval[1]
    blunt = math.log(found.intervals[REMANENCE][1] / found.intervals[REMANENCE][0])
    assert blunt > 3.0 * sharp


RECORD = PistonRecord(np.linspace(0.0, 3.0, 50), 0.06 + 1e-3 * np.sin(np.linspace(0, 60.0, 50)))


def quiet(*parameters: str, scene: Scene | None = None, **options: Any) -> Calibration:
    return calibrate(
        RECORD,
        scene or load_scene("damper"),
        parameters or (MASS, DRAG),
        progress=False,
        checks=False,
        **options,
    )


def accelerations() -> PistonRecord:
    return PistonRecord.from_columns({"time": RECORD.time, "acceleration": RECORD.height})


BAD: list[tuple[Callable[[], Any], str]] = [
    (lambda: quiet("piston.mas"), "did you mean 'mass'"),
    (lambda: quiet("piston.drag"), "since a start value above 0 is needed"),
    (lambda: quiet("grains.count"), "is not a quantity"),
    (lambda: quiet("effects"), "is not a quantity"),
    (lambda: quiet("effects.friction.static"), "has no effects.friction.static"),
    (lambda: quiet(MASS, MASS), "each only once"),
    (lambda: quiet(seeds=1), "from 2"),
    (lambda: quiet(seeds=10**60), "to 10000"),
    (lambda: quiet(confidence=1.0), "between 0 and 1"),
    (lambda: quiet(law="linaer"), "did you mean 'linear'"),
    (lambda: quiet(dt=-1.0), "above 0 s"),
    (lambda: quiet(method="euler?"), "unknown method"),
    (lambda: quiet(scene=load_scene("bed")), "moves freely"),
    (lambda: calibrate(accelerations(), load_scene("damper")), "calibrate needs heights"),
    (lambda: calibrate(RECORD, "damper"), "is not a Scene"),  # type: ignore[arg-type]  # what is refused
]


@pytest.mark.parametrize(("act", "words"), BAD, ids=[row[1] for row in BAD])
def test_invalid_arguments_of_a_calibration_are_refused(act: Callable[[], Any], words: str) -> None:
    with pytest.raises((InputError, SceneError)) as caught:
        act()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("nothing.csv damper", "does not exist"),
        ("damper damper", "is a scene; give a record"),
        ("still.csv damper", "give a record of a motion"),
        ("grows.csv damper", "unexplained, but the maximum is 50 %"),
        ("lab.csv dampr", "did you mean 'damper'"),
        ("lab.csv damper --parameter piston.weight", "unknown key 'weight'"),
        ("lab.csv damper --seeds 1", "from 2"),
        ("lab.csv damper --seeds few", "invalid int value"),
        ("lab.csv damper -o lab.csv", "is a file; give a directory"),
        ("lab.csv damper --set piston.mass=0", "must be above 0"),
        ("lab.csv single-particle", "has no piston"),
    ],
)
def test_invalid_command_lines_of_a_calibration_are_refused(
    words: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Callable[..., Any]
) -> None:
    monkeypatch.chdir(tmp_path)
    times = np.linspace(0.0, 2.0, 2000)
    decay = damped_cosine(times, 1e-3, 2.0)
    for name, height in (("lab", decay), ("grows", decay[::-1]), ("still", 0.0 * decay)):
        PistonRecord(times, 0.059 + height).to_csv(tmp_path / f"{name}.csv")
    done = command("reduced_models", "calibrate", *words.split(), "--quiet")
    assert (done.returncode, done.stderr.count("\n")) == (BAD_INPUT, 1)
    assert done.stderr.startswith("error: ")
    assert message in done.stderr
