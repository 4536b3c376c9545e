"""Hidden states at the start of a record, from the motion before it."""

from __future__ import annotations

import dataclasses
import functools
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import FitOptions, ReducedModel, fit
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.equation import compile_rates
from tests.reduced_models.models.test_printed_equation import assert_memory_as_printed

TRUE = {"omega": 1.05, "friction": 0.5, "rho": 1.0, "sigma": 0.8, "g0": -1.0}
TIME = np.linspace(0.0, 55.0, 2750)
CUT = 15.0
NOISE = 0.003


@functools.cache
def motion() -> np.ndarray:
    """Height, velocity and hidden state (3, n), by SciPy."""
    from scipy.integrate import solve_ivp

    law = LAWS["bouc-wen"]
    field = compile_rates(law.equation, (), "numpy")
    values = [TRUE[name] for name in law.parameters]
    found = solve_ivp(
        lambda _, y: [y[1], *field(*y, *values)],
        (0.0, TIME[-1]),
        [3.0, 0.0, 0.0],
        "DOP853",
        rtol=1e-10,
        atol=1e-12,
        t_eval=TIME,
    )
    return np.asarray(found.y)


def integer() -> PistonRecord:
    """A swing with hysteresis, that begins before the stretch that is fitted."""
    noise = np.random.default_rng(0).normal(0.0, NOISE, len(TIME))
    return PistonRecord(TIME, motion()[0] + noise)


@functools.cache
def check(law: str) -> ReducedModel:
    record = integer()
    before, after = record.between(0.0, CUT), record.between(CUT, TIME[-1])
    model = fit(after, law, starts=4, options=FitOptions(initial=before))
    assert model.quality.residual == pytest.approx(NOISE, rel=0.05)
    for name, value in TRUE.items():
        low, high = model.intervals[name]
        assert abs(model.parameters[name] - value) < 1.5 * (high - low)
    return model


def test_hidden_states_follow_from_what_was_before() -> None:
    model = check("bouc-wen")
    assert abs(true := motion()[2][np.searchsorted(TIME, CUT)]) > 0.2
    assert model.hidden["w"] == pytest.approx(true, abs=0.01)
    late = integer().between(CUT, TIME[-1])
    still = dataclasses.replace(model, hidden={}).simulate(late.time - late.time[0]).height
    assert np.abs(still - late.height).max() > 10.0 * NOISE


def test_python_of_a_model_starts_with_its_hidden_state() -> None:
    """Start the motion that runs alone, as the model does, where its hidden state is not zero."""
    model, times = check("bouc-wen"), np.linspace(0.0, 10.0, 300)
    assert abs(model.hidden["w"]) > 0.2
    space: dict[str, Any] = {}
    exec(model.numpy_source, space)
    np.testing.assert_allclose(space["simulate"](times), model.simulate(times).height, atol=1e-5)


def test_a_hysteresis_loop_has_the_work_of_its_force() -> None:
    """Energy of a Bouc-Wen cycle, by another solver, and the ends of its loop."""
    from scipy.integrate import solve_ivp

    model = check("bouc-wen")
    friction, rho, sigma = (model.parameters[key] for key in ("friction", "rho", "sigma"))
    size, omega = 6.0, 0.7

    def rates(t: float, state: np.ndarray) -> list[float]:
        w, v = state[0], -size * omega * np.sin(omega * t)
        return [rho * (v - sigma * abs(v) * abs(w) * w + (sigma - 1.0) * v * w**2), friction * w * v]

    period = 2.0 * np.pi / omega
    times = [0.0, 3.0 * period, 4.0 * period]
    work = solve_ivp(rates, (0, times[-1]), [0, 0], rtol=1e-9, atol=1e-10, t_eval=times).y[1]
    loop = model.harmonic_cycle(size, omega)
    assert loop.energy == pytest.approx(work[2] - work[1], rel=2e-3)
    assert 0.5 < loop.energy / (4.0 * friction * size) < 1.0
    assert model.harmonic_cycle(size, 2.0 * omega).energy == pytest.approx(loop.energy, rel=1e-9)


def test_printed_parameters_of_bouc_wen_are_those_of_its_swing() -> None:
    assert_memory_as_printed(check("bouc-wen"))


def test_a_free_hidden_state_is_found_from_the_motion_alone() -> None:
    """As it was, without the motion before."""
    free = fit(integer().between(CUT, TIME[-1]), "bouc-wen", starts=2, options=FitOptions(initial="free"))
    assert free.hidden["w"] == pytest.approx(motion()[2][np.searchsorted(TIME, CUT)], abs=0.01)
    assert free.quality.residual == pytest.approx(NOISE, rel=0.05)


@pytest.mark.long
def test_hidden_states_of_a_text() -> None:
    """With them as they were, no more is left over than where they are free."""
    model = check(LAWS["bouc-wen"].equation)
    late = integer().between(CUT, TIME[-1])
    free = fit(late, "bouc-wen", options=FitOptions(initial="free"))
    assert model.hidden["w"] == pytest.approx(free.hidden["w"], abs=0.1)
    assert model.quality.residual < 1.01 * free.quality.residual
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        wrong = fit(late, "bouc-wen")
    assert wrong.quality.residual > 1.5 * NOISE


def test_what_is_no_history(made: Callable[..., PistonRecord]) -> None:
    record = integer()
    late = record.between(CUT, TIME[-1])
    for initial, words in (
        (record.between(0.0, 5.0), r"ends at 4\.\d+ s, and the record begins at 15\.\d+ s; cut both"),
        (record, "cut both from one record"),
        ([record.between(0.0, CUT)] * 2, "2 motions for 1 records; give one before each"),
        (PistonRecord(TIME, TIME, force=TIME).between(0.0, CUT), "columns"),
    ):
        with pytest.raises(InputError, match=words):
            fit(late, "bouc-wen", options=FitOptions(initial=initial))
    with pytest.raises(InputError, match="has no hidden state"):
        fit(made("linear"), "linear", options=FitOptions(initial=record))
    with pytest.raises(InputError, match="or the motion before"):
        fit(late, "bouc-wen", options=FitOptions(initial=3))  # type: ignore[call-overload]  # what types forbid
