"""Laws in the user's own words, and what is said where words are not understood."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import FitOptions, Law, Parameter, ReducedModel, compare, fit
from reduced_models.fitting.fit import resolve_law
from reduced_models.laws import LAWS
from reduced_models.laws.law import law_from_text
from reduced_models.laws.solution import solve_law
from reduced_models.laws.symmetry import canonical_parameters, find_symmetries

PENDULUM = "theta'' + 2*lam*theta' + k*sin(theta - rest) = 0"
TIME = np.linspace(0.0, 40.0, 2000)


def pendulum(seed: int = 0) -> PistonRecord:
    law = Law("pendulum", PENDULUM)
    clean = solve_law(law, TIME, 0.9, 0.0, (0.03, 9.0, 0.2), 1.0).z
    return PistonRecord(TIME, clean + np.random.default_rng(seed).normal(0.0, 0.005, len(TIME)))


def test_an_angle_comes_home() -> None:
    """Whatever valley a start lies in, the rest is an angle and the stiffness is positive."""
    away = {"k": np.array([-9.0, 9.0]), "rest": np.array([0.2 + math.pi, 0.2 + 20.0 * math.pi])}
    law = law_from_text(PENDULUM)
    found = canonical_parameters(law, away | {"lam": np.zeros(2)})
    assert found["k"].tolist() == [9.0, 9.0]
    np.testing.assert_allclose(found["rest"], 0.2, rtol=1e-12)
    assert find_symmetries(law).turning == ("rest",)
    assert find_symmetries(law_from_text("z'' + w**2*z = g")).flipping == (("w", None),)
    assert find_symmetries(law_from_text("z'' + k*z = g")) == ((), ())


def test_home_lies_within_bounds() -> None:
    law = law_from_text(PENDULUM)
    values = {"lam": np.zeros(3), "k": np.array([9.0, -9.0, 9.0]), "rest": np.array([0.2, 9.0, -7.0])}
    same = [9.0 * np.sin(0.5 - 0.2), -9.0 * np.sin(0.5 - 9.0), 9.0 * np.sin(0.5 + 7.0)]
    for low, high in ((-20.0, 0.0), (0.0, math.inf), (-math.inf, math.inf)):
        found = canonical_parameters(law, values, bounds={"k": (low, high), "rest": (6.0, 13.0)})
        assert ((found["k"] >= low) & (found["k"] <= high)).all()
        assert ((found["rest"] >= 6.0) & (found["rest"] <= 13.0)).all()
        np.testing.assert_allclose(found["k"] * np.sin(0.5 - found["rest"]), same, rtol=1e-12)
    held = canonical_parameters(law, values, bounds={"rest": (9.0, 9.0)})
    assert held["k"].tolist() == [9.0, -9.0, 9.0]
    assert held["rest"].tolist() == [0.2, 9.0, -7.0]


@pytest.mark.long
def test_a_search_starts_within_bounds_on_the_other_sign() -> None:
    """A stiffness below zero with the rest half a turn on is the same pendulum."""
    model = fit(pendulum(), PENDULUM, parameters={"k": Parameter(low=-20.0, high=0.0)})
    assert model.parameters["k"] == pytest.approx(-9.0, rel=1e-3)
    assert math.sin(model.parameters["rest"] - 0.2) == pytest.approx(0.0, abs=2e-3)
    assert model.quality.converged >= 8


def fitted_pendulum(**options: Any) -> ReducedModel:
    """The fit of a pendulum, which finds it."""
    model = fit(pendulum(), PENDULUM, **options)
    assert model.parameters["k"] == pytest.approx(9.0, rel=1e-3)
    assert model.parameters["rest"] == pytest.approx(0.2, abs=2e-3)
    assert model.quality.residual == pytest.approx(0.005, rel=0.05)
    return model


HELD: dict[str, Any] = {
    "parameters": {"lam": Parameter(0.03, fixed=True), "k": Parameter(low=1.0)},
    "options": FitOptions(initial="free"),
}


@pytest.mark.long  # quick: its symmetries above, an own law in `test_fit`, a pendulum in `test_examples`
def test_a_pendulum_as_it_is_written() -> None:
    model = fitted_pendulum(starts=8)
    held = fitted_pendulum(**HELD)
    assert held.parameters["lam"] == pytest.approx(0.03, rel=1e-12)
    assert held.intervals["lam"] == pytest.approx((0.03, 0.03), rel=1e-12)
    free = np.diff(model.intervals["k"])[0]
    assert np.diff(held.intervals["k"])[0] < 1.01 * free
    assert "lam = 0.03 given" in held.provenance["fit"]
    assert held.quality.converged >= 8


@pytest.mark.long  # quick: a start that is given in `test_search`
def test_a_pendulum_from_other_starts() -> None:
    above_zero = dict.fromkeys(("k", "lam"), Parameter(low=0.0))
    for parameters in (above_zero, {"k": -8.0, "rest": 3.0}):
        fitted_pendulum(parameters=parameters)
    held, again = (fitted_pendulum(**HELD, seed=seed) for seed in (0, 2))
    assert again.parameters["k"] == pytest.approx(held.parameters["k"], rel=1e-6)
    assert again.quality.converged >= 8  # whatever the random starts


def test_the_time_in_a_law() -> None:
    """T is the time since the record's start, in fits and in later motions."""
    law = law_from_text("z'' + c*z' + k*z = a*t")
    assert law.inputs == ("t",)
    assert law.parameters == ("c", "k", "a")
    found = solve_law(law, TIME, 1.0, 0.0, (0.2, 1.1, 0.05), 1.0, [TIME])
    model = fit(
        PistonRecord(TIME + 100.0, found.z),
        law.equation,
        starts=1,
        options=FitOptions(input_interpolation="linear"),
    )
    for name, value in (("c", 0.2), ("k", 1.1), ("a", 0.05)):
        assert model.parameters[name] == pytest.approx(value, rel=1e-5)
    later = model.simulate(np.linspace(0.0, 60.0, 300))
    assert later.height[-1] == pytest.approx(0.05 * (60.0 - 0.2 / 1.1) / 1.1, rel=1e-3)


MEANT = {
    "z'' + c*z' + k*z = a*t": ("c", "k", "a"),  # t is the time
    "z'' + c*z' + 2*pi*k*z = g": ("c", "k", "g"),  # pi is a number
    "z'' + c*z' + k*(e**z - 1) = 0": ("c", "k"),  # and so is e
    "z'' + c*z' + k*z^3 = g": ("c", "k", "g"),
    "z'' + c*abs(z')*z' + k*z = g": ("c", "k", "g"),
    "z'' + c*Abs(z')*z' + k*Max(z - r, 0) = 0": ("c", "k", "r"),
    "z'' + λ*z' + ω**2*z = 0": ("λ", "ω"),
    "z'' + lambda*z' + k*z = 0": ("lambda", "k"),
    "theta'' + 2*lam*theta' + k*sin(theta - rest) = 0": ("lam", "k", "rest"),
    "x'' + c*x' + k*x = 0": ("c", "k"),
    "m*z'' + c*z' + k*z = 0": ("m", "c", "k"),
}


@pytest.mark.parametrize("text", MEANT)
def test_words_mean_what_they_say(text: str, made: Callable[..., PistonRecord]) -> None:
    """Each is read for a record, and what is fitted are the parameters, no more and no fewer."""
    assert resolve_law(text, made("linear")).parameters == MEANT[text]


ASKED_ABOUT = {
    "z'' + k*z = a*force": "add the column, or declare the parameter",
    "z'' + k*z = a*velocity": "write z' for it",
    "z'' + k*z = Pi": "write pi",
    "z'' + k*z = max()": "max",
    "z'' + k*z = sqare(z)": "is no function",
}


@pytest.mark.parametrize("text", ASKED_ABOUT)
def test_other_words_are_asked_about(text: str, made: Callable[..., PistonRecord]) -> None:
    """By `fit`, in one line that says what to write."""
    with pytest.raises(InputError) as caught:
        fit(made("linear"), text)
    assert ASKED_ABOUT[text] in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"parameters": ["omega"]}, "give a mapping"),
        ({"parameters": {"omege": 1.0}}, "omega"),
        ({"parameters": {"omega": Parameter(-1.0, fixed=True)}}, "parameter omega: it is above 0"),
        ({"parameters": {"g0": Parameter(0.0, low=0.0)}}, "parameter g0: it is above 0"),
        ({"parameters": {"omega": Parameter([1.0, 2.0], fixed=True)}}, "2 values for 1 records"),
        ({"parameters": {name: Parameter(1.0, fixed=True) for name in LAWS["linear"].parameters}}, "nothing"),
        ({"parameters": {"omega": "fast"}}, "parameter omega: 'fast' is not a quantity"),
        ({"parameters": {"omega": Parameter(low="1 m")}}, "a quantity in rad/s is wanted"),
        ({"parameters": {"omega": "3 Hz"}}, "give 2 pi times it"),
        ({"loss": "cauchy"}, "'linear', 'soft_l1' or 'huber'"),
        ({"weights": np.ones(3)}, r"one a sample \(2000\)"),
        ({"noise": -1.0}, "positive numbers"),
        ({"options": FitOptions(initial={"speed": 1.0})}, "state at the start"),
        ({"options": FitOptions(drift=True), "intervals": "profile"}, "know no drift"),
        ({"seed": -1}, "seed = -1; give an integer from 0 on"),
        ({"test_fraction": "a third"}, "give a fraction from 0 to 0.9"),
        ({"confidence": None}, "give a fraction between 0 and 1"),
    ],
)
def test_options_that_do_not_suit(
    made: Callable[..., PistonRecord], options: dict[str, Any], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        fit(made("linear"), "linear", **options)


def test_what_is_no_record_or_no_law(made: Callable[..., PistonRecord]) -> None:
    for wrong in (None, [TIME]):
        with pytest.raises(InputError, match="is no record; give a file"):
            # What types forbid is what is tried.
            fit(wrong, "linear")  # type: ignore[call-overload]  # what is refused
    with pytest.raises(InputError, match="give a name, an equation or a Law"):
        # Here too.
        fit(made("linear"), 3)  # type: ignore[call-overload]  # what is refused
    with pytest.raises(InputError, match="law = 3; give a name"):
        compare(made("linear"), [3])  # type: ignore[list-item]  # what is refused
    alone = compare(made("linear"), "linear")
    assert [row.name for row in alone.rows] == ["linear"]


def test_known_noise_weights_and_the_start(made: Callable[..., PistonRecord]) -> None:
    """What a user knows of a record is used, and means what it says."""
    record, level = made("linear"), 0.01 * float(made("linear").height.std())
    plain = fit(record, "linear")
    known = fit(record, "linear", noise=2.0 * level)
    for name in plain.parameters:
        wide = np.diff(known.intervals[name])[0] / np.diff(plain.intervals[name])[0]
        assert wide == pytest.approx(2.0, rel=0.1)
    # Samples that weigh nothing to speak of do not count, whatever they are.
    height = record.height.copy()
    height[500:520] += 1.0
    weights = np.ones(2000)
    weights[500:520] = 1e-6
    spared = fit(PistonRecord(TIME, height), "linear", weights=weights)
    for name, value in plain.parameters.items():
        assert spared.parameters[name] == pytest.approx(value, rel=2e-3)
    still = fit(record, "linear", options=FitOptions(initial="rest"))
    assert still.initial[1] == 0.0
    assert fit(record, "linear", options=FitOptions(initial="free")).initial == plain.initial
    given = fit(record, "linear", options=FitOptions(initial={"height": 1.0, "velocity": 0.0}))
    assert given.initial == pytest.approx((1.0, 0.0), abs=1e-12)


@pytest.mark.parametrize("loss", ["soft_l1", "huber"])
def test_outliers_weigh_little(made: Callable[..., PistonRecord], loss: Any) -> None:
    record, random = made("linear"), np.random.default_rng(3)
    height = record.height.copy()
    away = random.choice(2000, 60, replace=False)
    height[away] += random.normal(0.0, 20.0 * 0.01 * height.std(), 60)
    model = fit(PistonRecord(TIME, height), "linear", loss=loss)
    clean = fit(record, "linear")
    for name in clean.parameters:
        low, high = clean.intervals[name]
        assert abs(model.parameters[name] - clean.parameters[name]) < 0.6 * (high - low)
        assert np.diff(model.intervals[name])[0] < 1.5 * (high - low)


@pytest.mark.long
def test_eight_lengths_of_a_pendulum_tell_gravity_and_the_pivot(made: Callable[..., PistonRecord]) -> None:
    """A constant a record is given as a list; what is shared is found from all together."""
    law = "z'' + c*z' + g/(L + d)*z = 0"
    lengths, records = np.linspace(0.3, 1.5, 8), []
    for seed, length in enumerate(lengths):
        omega = math.sqrt(9.81 / (length + 0.02) - 0.01**2)
        height = 0.1 * np.exp(-0.01 * TIME[:500]) * np.cos(omega * TIME[:500])
        noise = np.random.default_rng(seed).normal(0.0, 0.001, 500)
        records.append(PistonRecord(TIME[:500], height + noise))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        models = fit(
            records, law, parameters={"g": 9.0, "d": 0.01, "L": Parameter(lengths.tolist(), fixed=True)}
        )
    for name, value in (("g", 9.81), ("d", 0.02), ("c", 0.02)):
        low, high = models[0].intervals[name]
        assert value == pytest.approx(models[0].parameters[name], abs=1.5 * (high - low))
    assert [model.parameters["L"] for model in models] == pytest.approx(lengths, rel=1e-12)
    assert models[0].undetermined == ()


def test_a_given_start_is_kept_in_its_units() -> None:
    """Height in metres and velocity in metres a second, of a record of millimetres."""
    time = np.linspace(0.0, 6.0, 1500)
    swing = 1.2e-3 * np.exp(-0.8 * time) * np.sin(21.8 * time)
    record = PistonRecord(time, 0.059 + swing)
    model = fit(record, "linear", starts=1, options=FitOptions(initial={"height": 0.059, "velocity": 0.026}))
    assert model.initial == pytest.approx((0.059, 0.026), rel=1e-12)
