"""Laws of a damper's force along a prescribed stroke (relative displacement): parameters, cycles and
options.
"""

import ctypes
import dataclasses
import itertools
import json
import math
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import PistonRecord
from granular.shared.errors import InputError, RecordError
from reduced_models import FitOptions, Law, Parameter, Sensor, compare, discover, fit, identify, load_model
from reduced_models.__main__ import main
from reduced_models.commands.identification import parse_laws
from reduced_models.laws import FORCE_LAWS
from reduced_models.laws import LAWS as PACKAGED_LAWS
from reduced_models.models.observed import measure_stroke_cycles, measured_cycles_with_cycles_of_law
from tests.reduced_models.made import assert_found, made_stroke, random_stroke

FORCE = FitOptions(measured="force")
LAWS = ("viscous-coulomb", "bouc-wen", "elastoplastic-bed")


@pytest.mark.parametrize("law", [*LAWS[:2], pytest.param(LAWS[2], marks=pytest.mark.long)])
def test_force_laws_are_recovered_from_simulated_records(law: str) -> None:
    record, truth = random_stroke(law, 0)
    given = {"rest": Parameter(truth.pop("rest"), fixed=True)} if "rest" in truth else {}
    assert_found(fit(record, law, parameters=given, options=FORCE), truth)


@pytest.mark.long
@pytest.mark.parametrize(
    ("law", "truth"),
    [
        ("saturation", {"limit": 20.0, "speed": 0.03, "k": 500.0, "zero": 0.1}),
        ("backlash", {"friction": 10.0, "gap": 0.002, "travel": 0.001, "c": 20.0, "k": 300.0, "zero": 0.0}),
    ],
)
def test_laws_with_saturation_and_backlash_are_recovered(law: str, truth: dict[str, float]) -> None:
    record = made_stroke(law, truth, 0.01, 1.5, 0.01, np.random.default_rng(3))
    model = fit(record, law, options=FORCE)
    assert model.quality.converged >= 12
    assert_found(model, truth)


def test_energy_loss_per_cycle_is_the_loss_by_friction_and_drag() -> None:
    law = Law(
        "known", "force = c*z' + friction*tanh(z'/creep) + k*z", positive=("creep",), units={"creep": "m/s"}
    )
    truth = {"c": 80.0, "friction": 6.0, "creep": 1e-4, "k": 900.0, "zero": 0.0}
    random = np.random.default_rng(0)
    record = made_stroke("viscous-coulomb", truth, 0.01, 1.5, 0.003, random)
    model = fit(record, law, parameters={"creep": Parameter(1e-4, fixed=True)})
    omega = 2.0 * math.pi * 3.0
    cycle = model.harmonic_cycle(0.004, omega)
    loss = math.pi * 80.0 * omega * 0.004**2 + 4.0 * 6.0 * 0.004
    assert abs(cycle.energy - loss) < 3.0 * cycle.errors[2] + 2e-4 * loss
    assert cycle.damping == pytest.approx(80.0 + 4.0 * 6.0 / (math.pi * omega * 0.004), rel=0.01)
    assert cycle.stiffness == pytest.approx(900.0, rel=0.01)
    # The record gives the same without a law.
    measured = model.cycles[-1]
    by_law = model.harmonic_cycle(measured.amplitude, measured.frequency)
    assert measured.energy == pytest.approx(by_law.energy, rel=0.01)
    assert measured.stiffness == pytest.approx(by_law.stiffness, rel=0.03)
    assert "loss per cycle" in str(model)
    with pytest.raises(InputError, match="no range of heights"):
        dataclasses.replace(model, domain={}).harmonic_cycle(0.004, 3.0)


def test_discovery_finds_the_law_of_a_force_along_a_stroke() -> None:
    truth = {"c": 80.0, "friction": 6.0, "creep": 1e-4, "k": 900.0, "zero": 0.5}
    record = made_stroke("viscous-coulomb", truth, 0.01, 1.5, 0.01, np.random.default_rng(0))
    found = discover(record, "sindy", target="force", library="physical", degree=1)
    assert {term.text for term in found.best.terms or {}} == {"1", "z", "z'", "sign(z')"}
    assert found.model.law.name == "viscous + dry friction + linear spring"
    assert_found(found.model, {"c0": 0.5, "c1": 6.0, "c2": 80.0, "c3": 900.0})


@pytest.mark.long
def test_discovery_finds_the_hysteresis_law_of_a_damper() -> None:
    truth = {"c": 80.0, "k": 900.0, "friction": 12.0, "zero": 0.0, "rho": 800.0, "sigma": 1.0}
    record = made_stroke("bouc-wen", truth, 0.01, 1.5, 0.01, np.random.default_rng(0))
    found = discover(record, "sindy", target="force", library="memory")
    assert found.best.hidden_state.kind.name == "displacement that yields"
    assert found.best.hidden_state.scales[0] == pytest.approx(1.0 / 800.0, rel=0.02)
    model: Any = found.model
    values = {term.text: value for term, value in (found.best.terms or {}).items()}
    assert values["u"] == pytest.approx(12.0 * 800.0, rel=0.02)
    assert values["z'"] == pytest.approx(80.0, rel=0.02)
    assert model.quality.relative == pytest.approx(0.01, rel=0.3)


def sine(frequency: float, amplitude: float, **parts: float) -> PistonRecord:
    """Return the record of a dashpot c, a spring k and a mass m along a sinusoidal stroke, with a
    little noise.
    """
    time = np.linspace(0.0, 4.0 / frequency, 800)
    phase = 2.0 * math.pi * frequency * time
    stroke, speed = amplitude * np.sin(phase), 2.0 * math.pi * frequency * amplitude * np.cos(phase)
    inertia = -((2.0 * math.pi * frequency) ** 2) * stroke
    force = parts.get("c", 0.0) * speed + parts.get("k", 0.0) * stroke + parts.get("m", 0.0) * inertia
    return PistonRecord(time, stroke, force=force + np.random.default_rng(0).normal(0.0, 0.01, 800))


def test_the_sign_of_a_reaction_force_is_reversed_with_a_warning() -> None:
    record = sine(2.0, 0.01, c=100.0, k=500.0)
    turned = PistonRecord(record.time, record.height, force=-record.columns["force"])
    with pytest.warns(UserWarning, match="reaction"):
        model = fit(turned, options=FORCE)
    assert model.parameters["c"] == pytest.approx(100.0, rel=1e-3)
    assert np.std(model.residuals(turned)) == pytest.approx(0.01, rel=0.1)
    kept = fit(turned, options=FitOptions(measured=Sensor("force", gain=1.0)))
    assert kept.parameters["c"] == pytest.approx(-100.0, rel=1e-3)
    with pytest.raises(InputError, match="has no z''"):
        _ = model.law.acceleration


def test_records_at_several_frequencies_determine_the_mass_in_a_force_law() -> None:
    records = [sine(frequency, 0.01, c=100.0, k=500.0, m=0.8) for frequency in (1.0, 6.0)]
    model, other = fit(records, "force = m*z'' + c*z' + k*z")
    assert model.parameters == other.parameters
    assert model.parameters["m"] == pytest.approx(0.8, rel=0.01)
    assert model.parameters["k"] == pytest.approx(500.0, rel=0.01)
    assert [round(item.frequency / (2.0 * math.pi), 1) for item in model.cycles] == [1.0, 6.0]
    assert min(item.measured for item in model.cycles) >= 2


def test_a_current_column_is_an_input_of_a_force_law() -> None:
    record, current = sine(2.0, 0.01, c=100.0), np.linspace(0.0, 2.0, 800)
    force = record.columns["force"] * (1.0 + 0.5 * current)
    driven = PistonRecord(record.time, record.height, force=force, extra={"current": current})
    driven = dataclasses.replace(driven, measured="force")
    model: Any = fit(driven, "force = (c + d*current)*z'")
    assert model.parameters["d"] == pytest.approx(50.0, rel=0.01)
    with pytest.raises(InputError, match="inputs current"):
        model.harmonic_cycle(0.01, 2.0)


def test_laws_of_motion_and_simulations_are_refused_for_a_prescribed_stroke() -> None:
    record = sine(2.0, 0.01, c=100.0)
    with pytest.raises(InputError, match="not a law of the force"):
        fit(record, "z'' + k*z = 0", options=FORCE)
    with pytest.raises(RecordError, match="'force'"):
        fit(PistonRecord(record.time, record.height), options=FORCE)
    with pytest.raises(InputError, match="is for a prescribed motion"):
        fit(record, "linear", options=FORCE).simulate(record.time)
    with pytest.raises(RecordError, match="--target force"):
        discover(dataclasses.replace(record, measured="force"))
    assert set(FORCE_LAWS) >= {"linear", "saturation", "backlash", *LAWS}


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """Return a file with a stroke [mm] and a force, with arbitrary column names."""
    record = sine(2.0, 0.01, c=100.0, k=500.0)
    table = np.column_stack([record.time, 1e3 * record.height, record.columns["force"]])
    np.savetxt(tmp_path / "rig.csv", table, delimiter=",", header="t,x [mm],cell [N]", comments="")
    return tmp_path / "rig.csv"


def test_a_stroke_column_is_selected_by_its_role(rig: Path, command: Callable[..., Any]) -> None:
    read = PistonRecord.from_file(rig, columns={"stroke": "x", "force": "cell"})
    assert read.measured == "force"
    assert set(read.columns) == {"time", "height", "force"}
    table = compare(read, ["viscous-coulomb", "linear"])
    assert table.best.law.name == "linear"
    assert "constant force" in table.verdict
    found = identify(read, laws=["linear", "viscous-coulomb"], progress=False)
    assert found.figures == ()
    assert "loss per cycle" in found.printout()
    assert "of rms force" in found.verdict
    with pytest.raises(RecordError, match="force="):
        PistonRecord.from_file(rig, columns={"stroke": "x"})
    out = rig.with_name("model.json")
    done = command("reduced_models", "fit", str(rig), "--columns", "stroke=x,force=cell", "-o", str(out))
    assert done.returncode == 0, done.stderr
    assert "loss per cycle" in done.stdout
    plain = json.loads(out.read_text())
    assert plain["parameters"]["c"] == pytest.approx(100.0, rel=1e-3)
    energy = math.pi * 2.0 * math.pi * 2.0 * 0.01**2 * 100.0
    assert plain["cycles"][0]["energy"] == pytest.approx(energy, rel=0.01)
    assert load_model(out).harmonic_cycle(0.01, 4.0 * math.pi).energy == pytest.approx(energy, rel=0.01)


def test_a_comparison_along_a_stroke_uses_the_force_laws(rig: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, ...]] = []

    def note_laws(records: Any, laws: tuple[str, ...], *others: Any, **further: Any) -> None:
        asked.append(laws)
        raise InputError("enough")

    monkeypatch.setattr("reduced_models.identification.comparison.compare", note_laws)
    for further in ((), ("--law", "all")):
        with pytest.raises(InputError, match="enough"):
            main(["compare", str(rig), "--columns", "stroke=x,force=cell", *further])
    assert asked == [tuple(name for name, law in FORCE_LAWS.items() if not law.given)] * 2


@pytest.mark.parametrize(("middle", "above"), [(0.0, False), (0.05, True)])
def test_comparison_of_all_laws_along_a_stroke_includes_all_force_laws(middle: float, above: bool) -> None:
    """Laws that require heights above 0 are included only for such records."""
    record = sine(2.0, 0.01, c=100.0)
    record = dataclasses.replace(record, height=record.height + middle, measured="force")
    chosen = parse_laws(("all",), [record])
    assert set(chosen) == {name for name, law in FORCE_LAWS.items() if above or not law.given}
    assert parse_laws(("all",)) == tuple(PACKAGED_LAWS)


def test_cycles_about_different_mean_heights_are_separate_rows_of_the_table() -> None:
    record = sine(2.0, 0.01, c=100.0, k=500.0)
    higher = dataclasses.replace(record, height=record.height + 0.03)
    force = record.columns["force"]
    apart = measure_stroke_cycles([record, higher], [force, force])
    assert sorted(cycle.centre for cycle in apart) == pytest.approx([0.0, 0.03], abs=1e-3)
    assert len(measure_stroke_cycles([record, record], [force, force])) == 1
    model = dataclasses.replace(fit(record, "linear", options=FORCE), cycles=apart)
    for measured, law in measured_cycles_with_cycles_of_law(model):
        assert law.centre == measured.centre


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"measured": "forse"}, "measured = 'forse'"),
        ({"initial": "resting"}, "initial = 'resting'"),
        ({"input_interpolation": "cubic"}, "'spline', 'linear', 'previous' or 'band-limited'"),
    ],
)
def test_options_of_a_fit_are_checked_on_creation(given: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        FitOptions(**given)


def test_force_law_is_saved_and_exported_like_other_laws(tmp_path: Path) -> None:
    """Weights and noise are arrays. The saved model and its Python code are tested along another stroke."""
    record, _ = random_stroke("bouc-wen", 1)
    weighted = fit(record, "bouc-wen", options=FORCE, weights=np.ones(len(record)))
    noise = np.full(len(record), weighted.quality.residual)
    known = fit(record, "bouc-wen", options=FORCE, noise=noise)
    assert known.parameters == pytest.approx(weighted.parameters, rel=1e-6)
    weighted.save(tmp_path / "model.json")
    model = load_model(tmp_path / "model.json")
    time, omega, size = np.linspace(0.0, 2.0, 8001), 9.0, 0.5 * float(np.ptp(record.height))

    def stroke(at: Any) -> tuple[Any, Any]:
        return size * np.sin(omega * at), size * omega * np.cos(omega * at)

    height, velocity = stroke(time)
    moving = PistonRecord(time, height, velocity=velocity)
    force = model.simulate_signal(moving)
    assert np.array_equal(force, weighted.simulate_signal(moving))
    model.export(tmp_path / "damper.py")
    names: dict[str, Any] = {}
    exec((tmp_path / "damper.py").read_text(), names)

    def rates(now: float, w: np.ndarray) -> Any:
        return names["rates"](*stroke(now), w)

    # From one turning point of |z'| to the next.
    turns = [0.0, *(turn for turn in (np.arange(6) + 0.5) * math.pi / omega if turn < 2.0), 2.0]
    states, state = np.zeros_like(time), np.array(names["START"])
    for first, last in itertools.pairwise(turns):
        inside = (time >= first) & (time <= last)
        at = np.unique(np.append(time[inside], last))
        path = solve_ivp(rates, (first, last), state, "DOP853", at, rtol=1e-11, atol=1e-12).y
        states[inside], state = path[0][: inside.sum()], path[:, -1]
    exported = np.array([names["force"](*stroke(now), [w]) for now, w in zip(time, states, strict=True)])
    assert np.abs(exported - force).max() < 1e-8 * force.std()


def test_exported_c_and_python_code_of_a_force_law_agree(tmp_path: Path) -> None:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    model: Any = fit(sine(2.0, 0.01, c=100.0, k=500.0), options=FORCE)
    model.export(tmp_path / "damper.c")
    library = tmp_path / "damper.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, tmp_path / "damper.c", "-lm"], check=True)
    loaded = ctypes.CDLL(str(library))
    loaded.damper_force.restype = ctypes.c_double
    numbers = (ctypes.c_double * 3).in_dll(loaded, "damper_parameters")
    inputs = (ctypes.c_double * 2)(0.004, -0.05)
    wanted = sum(
        value * factor for value, factor in zip(model.parameters.values(), (-0.05, 0.004, 1.0), strict=True)
    )
    assert loaded.damper_force(numbers, None, inputs) == pytest.approx(wanted, rel=1e-12)


def test_exported_files_state_the_direction_of_a_measured_force(tmp_path: Path) -> None:
    """The measured force is exerted by the surroundings on a flange.

    For a dashpot it has the sign of the velocity.
    """
    model: Any = fit(sine(2.0, 0.01, c=100.0), options=FORCE)
    for name in ("damper.py", "damper.c", "damper_force.m", "Damper.mo"):
        model.export(tmp_path / name)
        written = (tmp_path / name.replace(".c", ".h")).read_text(encoding="utf-8")
        assert "that moves the piston upwards [N]" in written
        assert "of the bed on the piston" not in written
    assert "  f = force;" in (tmp_path / "Damper.mo").read_text(encoding="utf-8")
