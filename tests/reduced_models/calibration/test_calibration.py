"""Numbers of a scene from a record: by made-up features, and by simulations of few grains."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from granular import PistonRecord, Scene, damper, load_scene, simulate
from granular.shared.console import BAD_INPUT, INTERRUPTED, launch
from granular.shared.errors import InputError, SceneError
from granular.studies.cases import Case
from reduced_models import Calibration, calibrate
from reduced_models.__main__ import main
from reduced_models.calibration.calibration import calibrated
from reduced_models.calibration.features import Features, features
from reduced_models.calibration.gauss_newton import RADIUS
from reduced_models.calibration.simulations import SceneSimulator, SimulatedPoint, parameter

MASS, DRAG, REMANENCE = "piston.mass", "effects.drag.coefficient", "grains.remanence"
NAMES = ("height", "period", "damping_ratio", "force")
RECORD = PistonRecord(np.linspace(0.0, 3.0, 50), 0.06 + 1e-3 * np.sin(np.linspace(0, 60.0, 50)))
NOISE, SCATTER = np.array([1e-3, 2e-3, 5e-3, 1e-3]), np.array([2e-3, 3e-3, 1e-2, 1e-9])


def made_features(mass: float, drag: float, remanence: float, bed: np.ndarray) -> np.ndarray:
    """Logarithms of the features of a made-up damper, with the scatter of its bed (4,).

    Level of rest and period hang on mass over remanence squared, but for the grains' weight.
    """
    load = math.log((mass + 0.1) / remanence**2)
    period = -0.2 * load + 0.03 * load**2
    damping = math.log(drag / (mass + 0.1)) + 0.1 * math.sin(load)
    return np.array([-0.35 * load, period, damping - 4.0, math.log(9.8 * mass)]) + SCATTER * bed


@dataclasses.dataclass(frozen=True)
class MadeUp(SceneSimulator):
    """A formula takes the place of the simulations.

    Attributes
    ----------
    shift : int
        Added to the seeds: other beds than those of another calibration.
    fails : callable
        Whether the simulations of a mass fail.
    asked : list of float64 (p,)
        The places that were asked for.
    """

    shift: int = 0
    fails: Callable[[float], bool] = lambda mass: False
    asked: list[np.ndarray] = dataclasses.field(default_factory=list)

    def points(self, places: Sequence[np.ndarray]) -> list[SimulatedPoint]:
        self.asked.extend(places)
        return [self.point(place) for place in places]

    def point(self, place: np.ndarray) -> SimulatedPoint:
        if self.fails(math.exp(place[0])):
            return SimulatedPoint(
                place, (), np.empty((0, 0)), "the simulation with it failed: boom"
            )
        plain = self.scene.replace(**self.changes(place))
        rows = []
        for seed in self.seeds:
            bed = np.random.default_rng(seed + self.shift).normal(size=4)
            drag = plain.effects.drag.coefficient
            rows.append(made_features(plain.piston.mass, drag, plain.grains.remanence, bed))
        records = (RECORD.from_zero(),) * len(rows)
        return SimulatedPoint(place, records, np.array(rows)[:, : 4 if self.force else 3])


class Lab(NamedTuple):
    """The features of a record of a bed with a random start of its own."""

    wanted: Features
    shift: int

    @classmethod
    def of(cls, seed: int, *, force: bool = False, **values: float) -> Lab:
        random = np.random.default_rng(seed)
        truth = {"mass": 7.5, "drag": 0.1, "remanence": 1.3} | values
        logs = made_features(**truth, bed=random.normal(size=4)) + NOISE * random.normal(size=4)
        used = slice(4 if force else 3)
        wanted = Features(NAMES[used], np.exp(logs[used]), NOISE[used], ())
        return cls(wanted, int(random.integers(1, 10**6)))

    def simulator(self, *keys: str, scene: Scene | None = None, **options: Any) -> MadeUp:
        """Where its features are looked for."""
        scene = scene or load_scene("damper")
        return MadeUp(
            scene=scene, parameters=tuple(parameter(scene, key) for key in keys or (MASS, DRAG)),
            seeds=(1, 2, 3, 4), law="linear", duration=3.0,
            force=len(self.wanted.names) == 4, settings={}, shift=self.shift, **options,
        )  # fmt: skip

    def calibrated(self, *keys: str, **options: Any) -> Calibration:
        simulator = self.simulator(*keys, **options)
        return calibrated(simulator, RECORD, self.wanted, 0.95, checks=False)


def quiet(*parameters: str, scene: Scene | None = None, **options: Any) -> Calibration:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return calibrate(
            RECORD, scene or load_scene("damper"), parameters or (MASS, DRAG), progress=False,
            checks=False, **options,
        )  # fmt: skip


def test_intervals_cover_the_truth() -> None:
    """Of 300 records of beds of their own, from other starts; 95 % intervals."""
    covered, halves = [], []
    for seed in range(300):
        found = Lab.of(seed, mass=6.0, drag=0.15).calibrated()
        assert found.undetermined == ()
        covered.append([
            found.intervals[key][0] <= value <= found.intervals[key][1]
            for key, value in ((MASS, 6.0), (DRAG, 0.15))
        ])  # fmt: skip
        halves.append(0.5 * math.log(found.intervals[MASS][1] / found.intervals[MASS][0]))
    assert (np.mean(covered, axis=0) >= 0.92).all()
    assert (np.mean(covered, axis=0) <= 0.99).all()
    # Neither is an interval idly wide: one standard deviation of the mass is about 0.7 %.
    assert np.median(halves) < 0.03


def test_a_start_far_away() -> None:
    """A third of the drag, twice the mass: in steps no longer than the radius."""
    lab = Lab.of(3, mass=3.75, drag=0.3)
    simulator = lab.simulator()
    found = calibrated(simulator, RECORD, lab.wanted, 0.95, checks=False)
    assert found.values == pytest.approx({MASS: 3.75, DRAG: 0.3}, rel=0.05)
    assert found.notes == ()
    assert len(simulator.asked) <= 3 + math.ceil(math.log(3.0) / RADIUS) + 3
    assert found.scene.piston.mass == found.values[MASS]


def test_what_cannot_be_told_apart_is_named() -> None:
    """A free swing tells mass over remanence squared; the force tells the mass."""
    found = Lab.of(1, mass=6.0).calibrated(MASS, DRAG, REMANENCE)
    assert len(found.undetermined) == 1
    powers = found.undetermined[0].powers
    assert powers[REMANENCE] / powers[MASS] == pytest.approx(0.5, abs=0.02)
    assert powers[DRAG] / powers[MASS] == pytest.approx(1.0, abs=0.1)
    low, high = found.intervals[MASS]
    assert low < 6.0 < high
    assert high / low > 5.0
    # What the data do say is found, also where mass and remanence alone are not.
    told = (found.values[MASS] + 0.1) / found.values[REMANENCE] ** 2
    assert told == pytest.approx(6.1 / 1.3**2, rel=0.03)
    assert "open: hardly identifiable from this record: " in str(found)

    found = Lab.of(1, mass=6.0, force=True).calibrated(MASS, DRAG, REMANENCE)
    assert found.undetermined == ()
    for key, value in ((MASS, 6.0), (DRAG, 0.1), (REMANENCE, 1.3)):
        low, high = found.intervals[key]
        assert low < value < high
        assert high / low < 1.3


def test_a_scene_that_lacks_something_is_noted() -> None:
    lab = Lab.of(1)
    wrong = lab.wanted._replace(values=lab.wanted.values * np.array([1.0, 1.3, 1.0]))
    notes = lab._replace(wanted=wrong).calibrated().notes
    assert notes
    for note in notes:
        assert note.startswith("no values give the record's")
        assert "standard deviations away" in note


def swing(mass: float, drag: float, seed: int, slower: float = 1.0) -> PistonRecord:
    """A piston on springs that are a little different from bed to bed."""
    time = np.linspace(0.0, 2.0, 2000)
    random = np.random.default_rng(seed)
    rest = 0.059 * (7.5 / mass) ** 0.35 * (1.0 + 1e-3 * random.normal())
    omega = 21.8 * (7.5 / mass) ** 0.1 * (1.0 + 1e-3 * random.normal()) / slower
    decay = 4.0 * drag / mass * 7.5 * (1.0 + 1e-2 * random.normal())
    height = rest + 1e-3 * np.exp(-decay * time) * np.cos(omega * time)
    return PistonRecord(time, height + random.normal(0.0, 3e-6, len(time)))


class Springs(Executor):
    """Answers a case with the swing of its mass and drag."""

    def submit(self, _: Callable[..., Any], case: Case, *__: Any) -> Future[Any]:
        scene, future = case.scene, Future[Any]()
        drag = scene.effects.drag.coefficient
        columns = swing(scene.piston.mass, drag, scene.arrangement.seed).columns
        figures = {name: values.tolist() for name, values in columns.items()}
        future.set_result({"figures": figures, "error": None})
        return future


def test_simulations_run_where_they_are_told_to(tmp_path: Path) -> None:
    """Those of an executor that is given; what does not fit is said, and all of it saved."""
    record = swing(7.0, 0.11, 100, slower=1.05)
    with pytest.warns(UserWarning, match="no values give the record's period"):
        found = calibrate(
            record, load_scene("damper"), seeds=3, executor=Springs(), out=tmp_path,
            checks=False, progress=False,
        )  # fmt: skip
    assert found.notes
    assert found.values[DRAG] == pytest.approx(0.11, rel=0.1)
    assert (tmp_path / "report.html").is_file()


def test_simulations_that_fail_on_the_way_shorten_the_step() -> None:
    """And those at the start end the calibration in one line."""
    lab = Lab.of(3, mass=3.75)

    def far(mass: float) -> bool:
        return not 3.6 < mass < 8.5

    assert lab.calibrated(fails=far).values[MASS] == pytest.approx(3.75, rel=0.03)
    heavy = load_scene("damper").replace(**{MASS: 20.0})
    with pytest.raises(InputError, match="boom; start from other values"):
        lab.calibrated(scene=heavy, fails=far)


def small(**changes: Any) -> Scene:
    """23 grains that come to rest soon."""
    return load_scene("damper").replace(
        **{
            "grains.count": 23,
            "cell.width": "15 D",
            "piston.height": "6 D",
            "piston.mass": 1.0,
            "arrangement.height": "5.5 D",
            "effects.drag.coefficient": 0.5,
            "protocol.release.duration": 2.0,
        }
        | changes
    )


def lab_record(scene: Scene, seed: int = 1, *, force: bool = False) -> PistonRecord:
    """A record of a run with noise of 1 % of its swing."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        record = simulate(scene, progress=False).piston()
    noise = np.random.default_rng(seed).normal(0.0, 0.01 * record.height.std(), len(record))
    return PistonRecord(record.time, record.height + noise, force=record.force if force else None)


def test_mass_and_drag_of_few_grains(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """From another random start, on the command line; again, without a further simulation.

    Simulations run here; `test_an_interrupted_calibration_goes_on` looks at processes of their own.
    """
    truth = {MASS: 1.15, DRAG: 0.42}
    lab_record(small(**truth, **{"arrangement.seed": 11})).to_parquet(tmp_path / "lab.parquet")
    small().save(tmp_path / "start.toml")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    words = ["calibrate", "lab.parquet", "start.toml", "--parameter", MASS, "--parameter", DRAG,
             "--seeds", "2", "-o", "out", "--no-checks", "--json", "--quiet"]  # fmt: skip
    here = ThreadPoolExecutor(1)
    place = "reduced_models.calibration.calibration.workshop"
    monkeypatch.setattr(place, lambda _: contextlib.nullcontext(here))
    assert launch(main, words) == 0
    printed = json.loads(capsys.readouterr().out)
    for key, value in truth.items():
        low, high = printed["parameters"][key]["interval"]
        assert low < value < high
        assert printed["parameters"][key]["value"] == pytest.approx(value, rel=0.05)
    kept = sorted((tmp_path / "out" / "simulations" / "cases").iterdir())
    assert len(kept) == printed["simulations"]
    times = [path.stat().st_mtime_ns for path in kept]
    assert launch(main, words) == 0
    assert json.loads(capsys.readouterr().out) == printed
    again = sorted((tmp_path / "out" / "simulations" / "cases").iterdir())
    assert [path.stat().st_mtime_ns for path in again] == times
    assert load_scene(tmp_path / "out" / "scene.toml").piston.mass == pytest.approx(1.15, rel=0.05)
    assert "calibrated" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.long
def test_an_interrupted_calibration_goes_on(tmp_path: Path) -> None:
    """Ctrl-C ends it in two lines; the same command makes no simulation a second time."""
    truth = {MASS: 1.15, DRAG: 0.42, "arrangement.seed": 11}
    lab_record(small(**truth)).to_csv(tmp_path / "lab.csv")
    small().save(tmp_path / "start.toml")
    words = [sys.executable, "-m", "reduced_models", "calibrate", "lab.csv", "start.toml",
             "--seeds", "2", "-o", "out", "--no-checks", "--quiet"]  # fmt: skip

    def kept() -> dict[Path, int]:
        cases = (tmp_path / "out" / "simulations" / "cases").glob("[!.]*.json")
        return {path: path.stat().st_mtime_ns for path in cases}

    first = subprocess.Popen(
        words, cwd=tmp_path, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
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
def test_mass_and_drag_of_a_bed(tmp_path: Path) -> None:
    """92 grains, three records of beds of their own: the truth lies within what is stated."""
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
def test_remanence_needs_the_force(tmp_path: Path) -> None:
    """Of 92 grains: with a column of force, mass, drag and remanence are told apart."""
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
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = calibrate(silent, start, keys, out=tmp_path, progress=False, checks=False)
    for one in found.parameters:
        assert one.interval[0] < truth[one.key] < one.interval[1]
    blunt = math.log(found.intervals[REMANENCE][1] / found.intervals[REMANENCE][0])
    assert blunt > 3.0 * sharp


def test_features_of_a_known_swing() -> None:
    """A linear oscillator: level of rest, undamped period and damping ratio, and its force."""
    times = np.linspace(0.0, 2.0, 2000)
    swing = 1e-3 * np.exp(-0.8 * times) * np.cos(math.sqrt(21.8**2 - 0.8**2) * times)
    force = 70.0 - 7.0 * 21.8**2 * swing
    record = PistonRecord(times, 0.059 + swing, force=force)
    found = features(record, "linear", force=True)
    assert found.names == NAMES
    expected = (0.059, 2.0 * math.pi / 21.8, 0.8 / 21.8, 70.0)
    assert tuple(found.values) == pytest.approx(expected, rel=2e-3)
    assert found.values[:3] == pytest.approx(expected[:3], rel=1e-6)


BAD: list[tuple[Callable[[], Any], str]] = [
    (lambda: quiet("piston.mas"), "did you mean 'mass'"),
    (lambda: quiet("piston.drag"), "starts from a value above 0"),
    (lambda: quiet("grains.count"), "is no quantity"),
    (lambda: quiet("effects"), "is no quantity"),
    (lambda: quiet("effects.friction.static"), "holds no effects.friction.static"),
    (lambda: quiet(MASS, MASS), "each once"),
    (lambda: quiet(seeds=1), "from 2 on"),
    (lambda: quiet(confidence=1.0), "between 0 and 1"),
    (lambda: quiet(law="linaer"), "did you mean 'linear'"),
    (lambda: quiet(dt=-1.0), "above 0 s"),
    (lambda: quiet(method="euler?"), "unknown method"),
    (lambda: quiet(scene=load_scene("bed")), "moves freely"),
]


@pytest.mark.parametrize(("act", "words"), BAD, ids=[row[1] for row in BAD])
def test_bad_arguments(act: Callable[[], Any], words: str) -> None:
    with pytest.raises((InputError, SceneError)) as caught:
        act()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("nothing.csv", "damper"), "there is no file"),
        (("nothing.parquet", "damper"), "there is no file"),
        (("damper", "damper"), "is a scene; give a record"),
        (("still.csv", "damper"), "a motion is needed"),
        (("grows.csv", "damper"), "unexplained, 50 % is the limit"),
        (("grows.csv", "damper", "--law", "z'' + 2*d*z' + k*z = g"), "damping ratio is -"),
        (("lab.csv", "dampr"), "did you mean 'damper'"),
        (("lab.csv", "damper", "--parameter", "piston.weight"), "unknown key 'weight'"),
        (("lab.csv", "damper", "--seeds", "1"), "from 2 on"),
        (("lab.csv", "damper", "--seeds", "few"), "invalid int value"),
        (("lab.csv", "damper", "-o", "lab.csv"), "is a file; give a directory"),
        (("lab.csv", "damper", "--set", "piston.mass=0"), "must be above 0"),
        (("lab.csv", "single-particle"), "has no piston"),
    ],
)
def test_bad_words(
    words: tuple[str, ...],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    times = np.linspace(0.0, 2.0, 2000)
    swing = 1e-3 * np.exp(-2.0 * times) * np.cos(21.8 * times)
    PistonRecord(times, 0.059 + swing).to_csv(tmp_path / "lab.csv")
    PistonRecord(times, 0.059 + swing[::-1]).to_csv(tmp_path / "grows.csv")
    PistonRecord(times, np.full(2000, 0.059)).to_csv(tmp_path / "still.csv")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    assert launch(main, ["calibrate", *words, "--quiet"]) == BAD_INPUT
    said = capsys.readouterr()
    assert said.err.startswith("error: ")
    assert said.err.count("\n") == 1
    assert message in said.err
