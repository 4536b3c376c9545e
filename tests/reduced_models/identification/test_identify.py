"""Identification from a scene, a run or a CSV file to the report."""

import dataclasses
import hashlib
import json
import math
import re
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import PistonRecord, Scene, simulate
from granular.run.trajectory import Trajectory
from granular.studies.cases import Case, CaseOutcome
from reduced_models import DiscoveryOptions, IdentifyOptions, compare, discover, identify, load_model
from reduced_models.identification import scene_checks
from reduced_models.identification.pictures import _break_at_gaps
from reduced_models.identification.result import Identification
from reduced_models.identification.scene_checks import RECORD, choose_step_check_run
from tests.reduced_models.made import damped_cosine, noise, noisy

UNCHECKED = IdentifyOptions(checks=False)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    time = np.linspace(0.0, 2.0, 2000)  # as in other tests, since fits of one shape are compiled once
    path = tmp_path_factory.mktemp("lab") / "lab.csv"
    noisy(time, 0.059 + damped_cosine(time, 0.0012), 3e-6, 3).to_csv(path)
    return path


@pytest.fixture(scope="module")
def spring(
    made: Callable[..., PistonRecord], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Identification, Path]:
    """Return the identification of a record that few laws can describe, and its directory."""
    out = tmp_path_factory.mktemp("spring")
    made("duffing").to_csv(out / "lab.csv")
    return identify(out / "lab.csv", out, starts=2, progress=False), out


def test_a_csv_file_is_identified_on_the_command_line(command: Callable, lab: Path, tmp_path: Path) -> None:
    words = ("--law", "linear", "--starts", "2", "-o", str(tmp_path / "out"), "--quiet")
    done = command("reduced_models", "identify", str(lab), *words)
    assert done.returncode == 0, done.stderr
    assert "z'' + 2*lam*z' + omega**2*z = g0" in done.stdout
    assert "LaTeX:" in (tmp_path / "out" / "equations.txt").read_text()
    assert (tmp_path / "out" / "report.html").read_text().startswith("<!doctype html>")
    model = load_model(tmp_path / "out" / "model.json")
    assert model.law.name == "linear"
    back = PistonRecord.from_csv(tmp_path / "out" / "record.csv")
    assert np.array_equal(back.height, PistonRecord.from_csv(lab).height)


def test_a_nonlinear_spring_is_identified_by_the_default_laws(spring: tuple[Identification, Path]) -> None:
    found, out = spring
    assert found.best.law.name == "duffing"
    assert {row.name for row in found.comparison.rows} == {"linear", "polynomial-spring", "duffing"}
    assert "the data cannot distinguish polynomial-spring from " in found.verdict
    for name in ("coulomb", "quadratic-drag"):
        assert any(f"{name} was not fitted" in words for words in found.left_out)
    assert found.residuals["duffing"].verdict == "noise"
    assert found.advice == ()
    fits_a_screen(found, " N/m per kg")
    page = (out / "report.html").read_text()
    assert "width=device-width" in page
    assert page.count("<svg") == 5
    assert page.count("<math") >= 3
    for words in (
        "95 % interval",
        "quality factor",
        "The laws compared",
        "Frequency and damping of the record",
    ):
        assert words in page
    assert "scipy " in page[page.index("<footer>") :]
    assert not re.search(r"(src|href)=\"http", page)
    assert "LaTeX:" in (out / "equations.txt").read_text()
    assert load_model(out / "model.json").law.name == "duffing"


def fits_a_screen(found: Identification, words: str) -> None:
    """Assert that at most 24 lines of 100 columns are printed above the line with the report's path."""
    text = found.printout()
    lines = text.splitlines()
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 100
    for expected in (found.best.law.equation, found.best.law.name, words):
        assert expected in text
    for label in (
        "natural frequency  f0 ",
        "damping ratio      zeta ",
        "equilibrium        z0 ",
        "these ± are 95 % intervals: ",
    ):
        assert label in text
    assert text.count("a linear model ") == (len(found.models) > 1)
    for parameter in found.parameters or found.best.parameter_quantities():
        assert f"{parameter.name} {parameter.text_with_error}" in " ".join(text.split())


@pytest.mark.long  # quick tests cover a run, one law of a file by command, a failed check, and falls
def test_identification_of_a_scene_includes_all_checks(
    small_damper: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scene_checks, "FALL_LAWS", ("power-law-spring", "linear"))  # quick to compile
    scene = small_damper.replace(
        **{
            "protocol.release.duration": 1.0,
            "protocol.drop.tolerance": "1e-3 D",
            "effects.drag.coefficient": 0.5,
        }
    )
    with ThreadPoolExecutor(1) as here:
        found = identify(scene, tmp_path / "out", options=IdentifyOptions(executor=here), progress=False)
    assert (tmp_path / "out" / "run" / "checkpoint.npz").is_file()
    page = (tmp_path / "out" / "report.html").read_text()
    for words in ("The bed before and after", "Energy balance", "Settings", "Computing time"):
        assert words in page
    for figure in (*found.figures, *found.own.figures):
        assert np.isfinite(figure.value)
        assert figure.parts["step"] < figure.total_error
        assert figure.parts["start"] > 0.0
    assert found.run.complete
    assert "linear" in {model.law.name for model in found.models}
    assert found.lift is not None
    assert all(len(row.records) == 1 for row in found.comparison.rows if not row.failure)
    assert "The held-out lift (three times the scene's lift) is predicted best by" in found.verdict
    assert "A held-out higher lift" in page
    assert found.falls.labels[-2:] == ("start 2", "start 3")
    assert len(found.falls.labels) >= 4  # grains may not fit under a lower piston
    assert found.falls.verdict in page
    fits_a_screen(found, "whole fall from ")
    assert "Held-out falls are predicted best by" in found.verdict
    assert (tmp_path / "out" / "fall.json").is_file()
    assert found.mass == scene.piston.mass
    assert any(one.unit == "N/m" for one in found.figures)
    again = identify(scene, tmp_path / "out", laws=["linear"], options=UNCHECKED, progress=False)
    assert again.seconds["simulation"] < 0.5 * found.seconds["simulation"] + 1.0
    assert json.dumps(again.to_plain())


@pytest.fixture(scope="module")
def run(small_damper: Scene, tmp_path_factory: pytest.TempPathFactory) -> Trajectory:
    """Return a short saved run with twice the automatic step."""
    scene = small_damper.replace(
        **{"protocol.drop.until": None, "protocol.drop.duration": 0.3, "protocol.release.duration": 1.0}
    )
    return simulate(scene, "auto*2", out=tmp_path_factory.mktemp("run") / "run", progress=False)


def test_a_run_is_identified(run: Trajectory) -> None:
    found = identify(run.path, laws=["linear"], starts=2, options=UNCHECKED, progress=False)
    assert np.array_equal(found.record.height, run.piston().height)
    assert "auto*2: " in str(found)


@pytest.mark.parametrize(
    ("dt", "phase", "other", "factor"),
    [
        ("auto", 0.2, "auto*2", 1.0),
        (1e-5, 0.5, 2e-5, 1.0),
        ("auto", 0.6, "auto/2", 4 / 3),
        (1e-5, 1.8, 5e-6, 4 / 3),
        ("auto*8", 0.1, "auto*4", 4 / 3),
    ],
)
def test_check_of_the_time_step_doubles_the_step_if_the_motion_is_still_resolved(
    run: Trajectory, monkeypatch: pytest.MonkeyPatch, dt: Any, phase: float, other: Any, factor: float
) -> None:
    settings = run.settings() | {"dt": dt, "step_times_highest_frequency": phase}
    monkeypatch.setattr(Trajectory, "settings", lambda _: settings)
    check = choose_step_check_run(run)
    assert check.changes == {"dt": other}
    assert check.factor == pytest.approx(factor)


class CallbackFuture(Future[Any]):
    """A future that calls a function before it returns its result."""

    def __init__(self, before: Callable[[], None]) -> None:
        super().__init__()
        self.before = before

    def result(self, timeout: float | None = None) -> Any:
        self.before()
        return super().result(timeout)


class FakeExecutor(Executor):
    """Executor that returns prepared outcomes and stores the submitted cases."""

    def __init__(self, *outcomes: PistonRecord | str, before: Callable[[], None] = list) -> None:
        self.outcomes, self.before = list(outcomes), before
        self.asked: list[Case] = []

    def submit(self, _: Callable[..., Any], case: Case, *__: Any) -> Future[Any]:
        one = self.outcomes[len(self.asked)]
        self.asked.append(case)
        future = CallbackFuture(self.before)
        if isinstance(one, str):
            future.set_result(CaseOutcome(error=one))
        else:
            columns = {name: values.tolist() for name, values in one.columns.items()}
            future.set_result(CaseOutcome({RECORD: columns}))
        return future


def test_checks_of_an_identification_use_the_time_step_of_the_run_and_the_identified_law(
    run: Trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    time = np.linspace(0.0, 1.0, 2000)
    swing = PistonRecord(time, 0.02 + damped_cosine(time, 1e-3, 2.0, 40.0))
    monkeypatch.setattr(Trajectory, "piston", lambda _: swing)
    made_up = FakeExecutor(*(PistonRecord(time / faster, swing.height) for faster in (1.01, 0.99, 1.03)))
    options = IdentifyOptions(executor=made_up)
    found = identify(run.path, laws=["linear"], starts=2, options=options, progress=False)
    assert [case.settings["dt"] for case in made_up.asked] == ["auto*2", "auto*2", "auto*4"]
    assert {case.settings["method"] for case in made_up.asked} == {"stormer-verlet"}
    seeds = [case.scene.arrangement.seed for case in made_up.asked]
    assert seeds == [run.scene.arrangement.seed + more for more in (1, 2, 0)]
    assert found.figures_law == "linear"
    for figure in (found.figure("natural frequency"), found.own.figures[0]):
        # The full change by twice the step.
        assert figure.parts["step"] == pytest.approx(0.03 * figure.value, rel=1e-3)
        # Student's factor for a further start, from three.
        start = math.sqrt(2.0) * 4.303 * 0.01 * figure.value
        assert figure.parts["start"] == pytest.approx(start, rel=0.02)


def test_a_failed_check_of_an_identification_gives_a_note_and_keeps_the_other_results(
    run: Trajectory, tmp_path: Path
) -> None:
    def saved() -> None:
        assert (tmp_path / "model.json").is_file()
        assert (tmp_path / "report.html").is_file()

    options = IdentifyOptions(
        executor=FakeExecutor(run.piston(), run.piston(), "EnergyError: step 3", before=saved)
    )
    with pytest.warns(UserWarning, match="check with twice the time step failed: EnergyError"):
        found = identify(run.path, tmp_path, laws=["linear"], starts=2, options=options, progress=False)
    frequency = found.figure("natural frequency")
    assert "step" not in frequency.parts
    assert frequency.parts["start"] < 1e-6 * frequency.value
    words = "the check with twice the time step failed: EnergyError: step 3"
    assert words in str(found)
    assert words in load_model(tmp_path / "model.json").notes
    assert words.replace("the check", "The check") in (tmp_path / "report.html").read_text()


def test_identification_of_an_interrupted_run_gives_a_note(run: Trajectory) -> None:
    cut = dataclasses.replace(run, complete=False)
    with pytest.warns(UserWarning, match=r"the run was stopped at t = 1\.3 s, in stage 'release'"):
        found = identify(cut, laws=["linear"], starts=2, progress=False)
    assert "was stopped" in found.notes[0]
    assert "step" not in found.figure("natural frequency").parts


@pytest.fixture(scope="module")
def accelerated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the acceleration in g of a linear decay at 3.4697 Hz with 3.667 % of critical damping."""
    time, root = np.linspace(0.0, 4.0, 2000), -0.8 + 21.8j
    acceleration = np.real(root**2 * 1.2e-3 * np.exp(root * time)) / 9.80665 + noise(2000, 2e-4, 1)
    path = tmp_path_factory.mktemp("accelerated") / "acc.csv"
    table, header = np.column_stack([time, acceleration]), "time [s],acceleration [g]"
    np.savetxt(path, table, "%.7f", ",", header=header, comments="")
    return path


AS_ACCELERATION = ("--columns", "acceleration=acceleration")


def test_a_recorded_acceleration_is_described_in_its_unit(accelerated: Path, command: Callable) -> None:
    done = command("reduced_models", "look", str(accelerated), *AS_ACCELERATION)
    assert re.search(r"^acceleration from -?0\.\d+ to 0\.\d+ m/s\^2, noise 0\.0\d+ m/s\^2", done.stdout, re.M)
    done = command("reduced_models", "look", str(accelerated), *AS_ACCELERATION, "--json")
    assert json.loads(done.stdout)["unit"] == "m/s^2"


def test_the_law_of_a_recorded_acceleration_is_identified(
    accelerated: Path, command: Callable, tmp_path: Path
) -> None:
    """Results, held-out cycles, amplitudes and plots are for the acceleration itself."""
    words = (*AS_ACCELERATION, "--law", "linear", "--starts", "1", "-o", str(tmp_path))
    done = command("reduced_models", "identify", str(accelerated), *words, "--quiet")
    assert done.returncode == 0, done.stderr
    natural = math.hypot(0.8, 21.8)
    assert float(re.search(r"f0 +([\d.]+) ±", done.stdout)[1]) == pytest.approx(natural / math.tau, rel=1e-3)
    assert float(re.search(r"zeta +([\d.]+) ±", done.stdout)[1]) == pytest.approx(80 / natural, rel=0.02)
    assert "of rms acceleration" in done.stdout
    assert "  amplitude  " in done.stdout
    assert "\n  equilibrium  " not in done.stdout
    page = (tmp_path / "report.html").read_text()
    digest = hashlib.sha256(accelerated.read_bytes()).hexdigest()
    for words in (
        digest,
        "acc.csv",
        f"identify {accelerated}",
        "acceleration [m/s²]",
        "the record has no position",
    ):
        assert words in page or words.capitalize() in page
    assert page.index("<math") < page.index("<h2>")  # on the first screen


def test_laws_of_a_recorded_acceleration_are_compared_and_predict_it(accelerated: Path) -> None:
    record = PistonRecord.from_file(accelerated, columns={"acceleration": "acceleration"})
    table = compare(record, ["linear", "coulomb"], test_records=[record], starts=1)
    assert [row.name for row in table.rows] == ["linear", "coulomb"]
    noise = 9.80665 * 2e-4 / record.signal.std()
    assert table.rows[0].records[0].relative == pytest.approx(noise, rel=0.05)
    assert table.rows[0].stretches[0] == pytest.approx(noise, rel=0.1)


@pytest.mark.parametrize("measured", ["acceleration", pytest.param("velocity", marks=pytest.mark.long)])
def test_a_law_is_discovered_from_a_recorded_velocity_or_acceleration(
    accelerated: Path, measured: str
) -> None:
    given = PistonRecord.from_file(accelerated, columns={"acceleration": "acceleration"})
    record = PistonRecord.from_columns({"time": given.time, measured: given.signal})
    found = discover(record, "sindy", library="physical", degree=1)
    assert found.model.law.equation == "z'' = c0*z' + c1*z"
    assert found.model.parameters["c1"] == pytest.approx(-(0.8**2 + 21.8**2), rel=1e-3)
    assert found.model.parameters["c0"] == pytest.approx(-1.6, rel=0.02)
    assert any(f"from the integrated {measured}" in note for note in found.notes)


def test_a_note_lists_columns_that_discovery_does_not_use() -> None:
    time = np.linspace(0.0, 2.0, 2000)
    record = PistonRecord(time, damped_cosine(time), force=np.sin(5.0 * time))
    found = discover(record, "sindy", library="physical", degree=1, options=DiscoveryOptions(polish=0))
    assert "columns not used as an input: force; to use one as the drive, pass input=NAME" in str(found)


def test_the_result_printed_before_the_checks_has_only_digits_that_are_certain(
    spring: tuple[Identification, Path],
) -> None:
    words = spring[0].line_before_checks
    assert words.endswith("; uncertainties follow")
    assert "±" not in words
    assert all(len(number.replace(".", "").lstrip("0")) <= 3 for number in re.findall(r"\d[\d.]*", words))


def test_missing_samples_of_a_record_are_shown_as_gaps_in_plots() -> None:
    time = np.arange(20.0)
    kept = (time < 5) | (time > 9)
    shown, values = _break_at_gaps(time[kept], time[kept])
    assert np.flatnonzero(np.isnan(shown)).tolist() == [5]
    assert np.isnan(values[5])
    assert not np.isnan(_break_at_gaps(time, time)[0]).any()
