"""Selection of the laws for a record: screening, discovery if they fail, and removal of outliers."""

import dataclasses
import functools
import importlib
import math
import shlex
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import odeint

from granular.shared.errors import InputError, RecordWarning
from reduced_models import PistonRecord, fit, identify
from reduced_models.discovery import discover as discovery
from reduced_models.identification import laws_of_record as identification
from reduced_models.identification.candidate_laws import (
    CANDIDATES,
    CandidateLaws,
    LawScreening,
    choose_candidate_laws,
    does_frequency_rise,
    drive_option_text,
    law_driven_by_column,
    screen_laws_by_weak_form,
    unused_drive_columns,
)
from reduced_models.identification.comparison import compare
from reduced_models.identification.comparison_table import Comparison
from reduced_models.identification.result import Identification
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.equation import compile_rates
from reduced_models.laws.law import Law
from reduced_models.records.sources import read_record
from tests.reduced_models.conftest import TIME, TRUE
from tests.reduced_models.made import damped_cosine, moved, noise, noisy


@functools.cache
def clean(name: str) -> np.ndarray:
    """Return the motion of a law by SciPy's solver, which needs no compilation."""
    law, (values, start) = LAWS[name], TRUE[name]
    field = compile_rates(law.equation, (), "math")
    numbers = [values[key] for key in law.parameters]

    def slopes(state: np.ndarray, _: float) -> tuple[float, ...]:
        return (float(state[1]), *field(*map(float, state), *numbers))

    return np.asarray(
        odeint(slopes, [start, 0.0, *(0.0,) * len(law.hidden)], TIME, rtol=1e-9, atol=1e-11)[:, 0]
    )


@pytest.mark.parametrize("level", [0.01, pytest.param(0.1, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", CANDIDATES)
def test_screening_never_excludes_the_true_law(name: str, level: float) -> None:
    record = noisy(TIME, clean(name), level * clean(name).std())
    found = screen_laws_by_weak_form(record, [LAWS[each] for each in CANDIDATES])
    assert not found.is_hopeless(name)
    assert found.misfits[name] < 3.0 * max(found.smallest_misfit, 1.0)


def test_screening_excludes_laws_with_a_large_misfit_and_lists_them(made: Any) -> None:
    found = choose_candidate_laws(made("duffing"))
    names = [law.name for law in found.laws]
    assert names == ["linear", "polynomial-spring", "duffing"]
    assert len(found.exclusion_texts) == len(CANDIDATES) - len(names)
    assert any("--law coulomb" in words for words in found.exclusion_texts)


def test_law_of_a_bed_with_friction_is_tried_if_the_frequency_rises_during_the_decay() -> None:
    assert choose_candidate_laws(PistonRecord(TIME, clean("rubbing-bed"))).laws[-1].name == "rubbing-bed"
    for name in ("linear", "viscous-coulomb", "quadratic-drag"):
        assert not does_frequency_rise(PistonRecord(TIME, clean(name))), name


def test_screening_suggests_discovery_for_a_record_of_an_unknown_law(made: Any) -> None:
    """For hysteresis, additional terms explain more than any screened law. For a linear decay they do not."""
    assert choose_candidate_laws(made("bouc-wen", level=0.0)).screening.other_terms_fit_better
    assert not choose_candidate_laws(made("linear")).screening.other_terms_fit_better


def test_a_record_too_short_for_screening_is_fitted_with_all_laws() -> None:
    """The record has half a cycle."""
    time = np.linspace(0.0, 1.0, 24)
    found = choose_candidate_laws(PistonRecord(time, 0.06 + 0.001 * np.cos(3.0 * time)))
    assert len(found.laws) >= 1
    assert found.laws[0].name == "linear"


def test_a_column_of_a_record_can_drive_a_law_and_unused_columns_are_listed() -> None:
    time = np.linspace(0.0, 6.0, 600)
    swing = np.cos(20.0 * time)
    # columns derived from the motion, as in files of Tracker
    columns = dict.fromkeys(("x", "vx", "k", "px", "kinetic energy", "frame"), swing)
    columns |= {"u": np.sin(3.0 * time), "still": np.zeros(600), "load cell": time}
    record = PistonRecord(time, 0.06 + 0.001 * swing, extra=columns)
    assert unused_drive_columns(record, (LAWS["linear"],)) == ("u", "load cell")
    law = law_driven_by_column(LAWS["linear"], record, "u")
    assert law.inputs == ("u",)
    assert set(law.parameters) == {"lam", "omega", "g0", "gain"}
    assert unused_drive_columns(record, (law,)) == ("load cell",)
    for name, words in (
        ("w", "no column 'w'; columns that can be a drive: "),
        ("still", "is zero everywhere"),
        ("load cell", "rename the column"),
    ):
        with pytest.raises(InputError, match=words):
            law_driven_by_column(LAWS["linear"], record, name)


@pytest.mark.parametrize("name", ["pump", "angvel/rad/s", "pump/V DC", "lam"])
def test_options_suggested_for_a_driving_column_are_accepted(name: str, tmp_path: Path) -> None:
    time, path = np.linspace(0.0, 4.0, 400), tmp_path / "lab.csv"
    table, header = np.column_stack([time, 0.2 * np.cos(7.0 * time), np.sin(3.0 * time)]), "time/s,angle/rad,"
    np.savetxt(path, table, "%.6f", ",", header=header + name, comments="")
    (column,) = unused_drive_columns(read_record(path), [])
    options = shlex.split(drive_option_text(column))
    named = dict([options[options.index("--columns") + 1].split("=")]) if "--columns" in options else {}
    record = read_record(path, columns=named)
    for law in CANDIDATES:
        assert law_driven_by_column(LAWS[law], record, options[-1]).inputs == (options[-1],)


def test_heights_about_zero_exclude_laws_that_require_positive_heights() -> None:
    time = np.linspace(0.0, 2.0, 1000)
    words = choose_candidate_laws(noisy(time, damped_cosine(time), 1e-6)).exclusion_texts
    reason = "power-law-spring was not fitted: it is undefined for heights that reach zero"
    assert any(one.startswith(reason) for one in words)
    assert not any(",000,000" in one for one in words)


QUADRATIC = "z'' + c*abs(z')*z' + w*z + b*z**3 = 0"


def test_the_law_of_dry_friction_with_drag_is_tried() -> None:
    """The record is of a spring at 2 Hz with dry friction of 0.15 m/s^2 and 1 % of critical damping."""
    time, omega = np.linspace(0.0, 3.5, 700), 4.0 * math.pi
    motion = moved(
        lambda t, z, v: -(omega**2) * z - 0.02 * omega * v - 0.15 * math.tanh(v / 1e-4),
        time, 0.02, method="LSODA", rtol=1e-8, atol=1e-10,
    )  # fmt: skip
    misfits = choose_candidate_laws(noisy(time, 0.05 + motion, 2e-5)).screening.misfits
    assert min(misfits, key=misfits.__getitem__) == "viscous-coulomb"


@pytest.fixture
def poor(monkeypatch: pytest.MonkeyPatch) -> PistonRecord:
    """Return a record for which the linear law is the only candidate, and fits poorly."""
    chosen = CandidateLaws((LAWS["linear"],), LawScreening({}, 1.0))
    monkeypatch.setattr(identification, "choose_candidate_laws", lambda *_: chosen)
    time = np.linspace(0.0, 20.0, 1000)
    return noisy(time, moved(lambda t, z, v: -0.1 * abs(v) * v - 4.0 * z - 3.0 * z**3, time), 1e-3)


def test_discovery_starts_automatically_if_the_error_of_the_best_law_is_above_a_tenth(
    poor: PistonRecord, monkeypatch: pytest.MonkeyPatch
) -> None:
    law = Law("found", QUADRATIC)
    model = fit(poor, law, starts=2, parameters={"c": 0.1, "w": 4.0, "b": 3.0})
    monkeypatch.setattr(discovery, "discover", lambda *_, **__: types.SimpleNamespace(model=model))
    found = identify(poor, progress=False, starts=2)
    assert [row.name for row in found.comparison.rows] == ["found", "linear"]
    assert found.comparison.rows[1].error > 0.1
    assert {one.law.name for one in found.models} == {"found", "linear"}
    assert found.advice == ()


def test_a_failed_automatic_discovery_gives_only_a_note(
    poor: PistonRecord, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> Any:
        raise InputError("no terms")

    monkeypatch.setattr(discovery, "discover", fail)
    found = identify(poor, progress=False, starts=2)
    assert found.best.law.name == "linear"
    assert any(words.startswith("discovery by sindy: no terms") for words in found.left_out)
    with pytest.raises(InputError, match="no terms"):
        identify(poor, progress=False, starts=2, discovery="sindy")


identifying = importlib.import_module("reduced_models.identification.laws_of_record")


def spiked() -> PistonRecord:
    """Return a linear decay with 16 samples per cycle, one of them an outlier."""
    time = np.arange(0.0, 10.0, 1.0 / 16.0)
    height = 0.06 + damped_cosine(time, 1e-3, 0.1, 2.0 * np.pi) + noise(len(time), 1e-5)
    height[80] -= 4e-4
    return PistonRecord(time, height)


def identified(record: PistonRecord) -> Identification:
    """Identification of a record by the linear and the Coulomb law."""
    return identify(record, laws=["linear", "coulomb"], starts=2, progress=False)


def test_an_outlier_is_removed_with_a_note_unless_the_user_requests_the_complete_record() -> None:
    record = spiked()
    with pytest.warns(RecordWarning, match="spikes"):
        found = identified(record)
    assert len(found.record) == len(record) - 1
    words = "single samples far from the fitted motion (spikes: 1, the first at 5 s) are excluded; "
    assert f"{words}to keep them: PistonRecord(..., complete=True)" in " ".join(str(found).split())
    assert len(identified(dataclasses.replace(record, complete=True)).record) == len(record)


@pytest.mark.parametrize("fitted", [1, 0])
def test_the_first_comparison_is_kept_if_the_second_exceeds_the_time_budget(
    monkeypatch: pytest.MonkeyPatch, fitted: int
) -> None:
    """The time limit may end the comparison without outliers; the fits with all samples are then kept."""
    record = spiked()

    def compare_in_time(samples: PistonRecord, laws: Any, **how: Any) -> Comparison:
        if len(samples) < len(record) and not fitted:
            raise InputError("no law could be fitted")
        table = compare(samples, laws, **how)
        if len(samples) == len(record):
            return table
        spent = (dataclasses.replace(row, models=(), failure="spent") for row in table.rows[fitted:])
        return dataclasses.replace(table, rows=(*table.rows[:fitted], *spent))

    monkeypatch.setattr(identifying, "compare", compare_in_time)
    with pytest.warns(RecordWarning, match="are kept: without them, not all laws"):
        found = identified(record)
    assert len(found.record) == len(record)
    assert {row.name for row in found.comparison.rows if row.models} == {"linear", "coulomb"}
    assert "raise --budget" in " ".join(str(found).split())
