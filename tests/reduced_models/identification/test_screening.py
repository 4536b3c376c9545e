"""A glance at the laws: the true one is never left out, and those far off are."""

from __future__ import annotations

import functools
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import odeint

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models.identification.candidate_laws import (
    CANDIDATES,
    choose_candidate_laws,
    drive_option_text,
    driven_law,
    frequency_rises,
    screen_laws_by_weak_form,
    unused_columns,
)
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.equation import compile_rates
from reduced_models.records.sources import read_record
from tests.reduced_models.conftest import TIME, TRUE


@functools.cache
def clean(name: str) -> np.ndarray:
    """The motion of a law by a solver of another house, that compiles nothing."""
    law, (values, start) = LAWS[name], TRUE[name]
    field = compile_rates(law.equation, (), "math")
    numbers = [values[key] for key in law.parameters]

    def slopes(state: np.ndarray, _: float) -> tuple[float, ...]:
        return (float(state[1]), *field(*map(float, state), *numbers))

    return np.asarray(
        odeint(slopes, [start, 0.0, *(0.0,) * len(law.hidden)], TIME, rtol=1e-9, atol=1e-11)[:, 0]
    )


@pytest.mark.parametrize("level", [0.01, *(pytest.param(one, marks=pytest.mark.long) for one in (0.0, 0.1))])
@pytest.mark.parametrize("name", CANDIDATES)
def test_the_true_law_is_never_left_out(name: str, level: float) -> None:
    z = clean(name)
    record = PistonRecord(TIME, z + np.random.default_rng(0).normal(0.0, level * z.std(), len(z)))
    found = screen_laws_by_weak_form(record, [LAWS[each] for each in CANDIDATES])
    assert not found.is_hopeless(name)
    assert found.misfits[name] < 3.0 * max(found.least_misfit, 1.0)


def test_laws_that_are_far_off_are_left_out_and_said_to_be(made: Any) -> None:
    found = choose_candidate_laws(made("duffing"))
    names = [law.name for law in found.laws]
    assert names == ["linear", "polynomial-spring", "duffing"]
    assert len(found.exclusion_texts) == len(CANDIDATES) - len(names)
    assert any("--law coulomb" in words for words in found.exclusion_texts)


def test_a_record_that_sticks_gets_the_law_of_rubbing_beds() -> None:
    assert choose_candidate_laws(PistonRecord(TIME, clean("rubbing-bed"))).laws[-1].name == "rubbing-bed"
    for name in ("linear", "viscous-coulomb", "quadratic-drag"):
        assert not frequency_rises(PistonRecord(TIME, clean(name))), name


def test_a_record_without_its_law_asks_for_a_discovery(made: Any) -> None:
    """Hysteresis is none of the laws, and more terms explain it better; a linear swing is one."""
    assert choose_candidate_laws(made("bouc-wen", level=0.0)).screening.other_terms_fit_better
    assert not choose_candidate_laws(made("linear")).screening.other_terms_fit_better


def test_what_cannot_be_looked_at_is_fitted() -> None:
    """A record of half a swing tells nothing at a glance."""
    time = np.linspace(0.0, 1.0, 24)
    found = choose_candidate_laws(PistonRecord(time, 0.06 + 0.001 * np.cos(3.0 * time)))
    assert len(found.laws) >= 1
    assert found.laws[0].name == "linear"


def test_a_column_that_drives() -> None:
    time = np.linspace(0.0, 6.0, 600)
    record = PistonRecord(
        time,
        0.06 + 0.001 * np.cos(20.0 * time),
        extra={
            "u": np.sin(3.0 * time),
            "still": np.zeros(600),
            "load cell": time,
            # of the motion itself, as Tracker writes them
            **{name: np.cos(20.0 * time) for name in ("x", "vx", "k", "px", "kinetic energy", "frame")},
        },
    )
    assert unused_columns(record, (LAWS["linear"],)) == ("u", "load cell")
    law = driven_law(LAWS["linear"], record, "u")
    assert law.inputs == ("u",)
    assert set(law.parameters) == {"lam", "omega", "g0", "gain"}
    assert unused_columns(record, (law,)) == ("load cell",)
    for name, words in (
        ("w", "no column 'w'; further columns: "),
        ("still", "is zero everywhere"),
        ("load cell", "rename it"),
    ):
        with pytest.raises(InputError, match=words):
            driven_law(LAWS["linear"], record, name)


@pytest.mark.parametrize("name", ["pump", "angvel/rad/s", "pump/V DC", "lam"])
def test_the_advice_to_drive_by_a_column_can_be_followed(name: str, tmp_path: Path) -> None:
    time = np.linspace(0.0, 4.0, 400)
    columns = [time, 0.2 * np.cos(7.0 * time), np.sin(3.0 * time)]
    rows = [",".join(f"{one:.6f}" for one in row) for row in zip(*columns, strict=True)]
    (tmp_path / "lab.csv").write_text("\n".join([f"time/s,angle/rad,{name}", *rows]))
    record = read_record(tmp_path / "lab.csv")
    (column,) = unused_columns(record, [])
    options = shlex.split(drive_option_text(column))
    named = dict([options[options.index("--columns") + 1].split("=")]) if "--columns" in options else {}
    record = read_record(tmp_path / "lab.csv", columns=named)
    for law in CANDIDATES:
        assert driven_law(LAWS[law], record, options[-1]).inputs == (options[-1],)


def test_heights_about_zero_are_the_reason_why_a_law_was_not_fitted() -> None:
    time = np.linspace(0.0, 2.0, 1000)
    swing = np.exp(-0.8 * time) * np.cos(21.8 * time)
    noise = np.random.default_rng(0).normal(0.0, 1e-3, len(time))
    words = choose_candidate_laws(PistonRecord(time, 1e-3 * (swing + noise))).exclusion_texts
    reason = "power-law-spring was not fitted: it cannot describe heights about zero"
    assert any(one.startswith(reason) for one in words)
    assert not any(",000,000" in one for one in words)
