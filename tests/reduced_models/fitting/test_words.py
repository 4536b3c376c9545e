"""Laws, parameters and options given as text, and the error messages for wrong ones."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import FitOptions, Parameter, compare, fit
from reduced_models.fitting.fit import resolve_law
from reduced_models.fitting.parameter import parameter_settings, parameters_by_name
from reduced_models.laws import FORCE_LAWS, LAWS
from reduced_models.laws.law import law_from_text
from reduced_models.laws.solution import solve_law
from reduced_models.laws.symmetry import canonical_parameters, find_parameter_symmetries
from tests.reduced_models.made import assert_found, damped_cosine, half_width, moved, noisy

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")

PENDULUM = "theta'' + 2*lam*theta' + k*sin(theta - rest) = 0"
TIME = np.linspace(0.0, 40.0, 2000)


def pendulum() -> PistonRecord:
    return noisy(TIME, moved(lambda t, z, v: -0.06 * v - 9.0 * np.sin(z - 0.2), TIME, 0.9), 0.005)


def test_fitted_angle_is_reduced_to_its_canonical_form() -> None:
    """From any starting point, the equilibrium angle is reduced and the stiffness is positive."""
    away = {"k": np.array([-9.0, 9.0]), "rest": np.array([0.2 + math.pi, 0.2 + 20.0 * math.pi])}
    law = law_from_text(PENDULUM)
    found = canonical_parameters(law, away | {"lam": np.zeros(2)})
    assert found["k"].tolist() == [9.0, 9.0]
    np.testing.assert_allclose(found["rest"], 0.2, rtol=1e-12)
    assert find_parameter_symmetries(law).turning == ("rest",)
    assert find_parameter_symmetries(law_from_text("z'' + w**2*z = g")).flipping == (("w", None),)
    assert find_parameter_symmetries(law_from_text("z'' + k*z = g")) == ((), ())


def test_the_canonical_form_of_an_angle_respects_the_bounds_of_parameters() -> None:
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
def test_the_search_starts_within_bounds_that_allow_only_the_opposite_sign() -> None:
    """A negative stiffness with the equilibrium half a turn away is the same pendulum."""
    model = fit(pendulum(), PENDULUM, parameters={"k": Parameter(low=-20.0, high=0.0)})
    assert model.parameters["k"] == pytest.approx(-9.0, rel=1e-3)
    assert math.sin(model.parameters["rest"] - 0.2) == pytest.approx(0.0, abs=2e-3)
    assert model.quality.converged >= 8


@pytest.mark.long  # quick: its symmetries above, a custom law in `test_fit`, a pendulum in `test_examples`
def test_a_pendulum_is_fitted_with_free_and_with_given_parameters() -> None:
    held: dict[str, Any] = {
        "parameters": {"lam": Parameter(0.03, fixed=True), "k": Parameter(low=1.0)},
        "options": FitOptions(initial="free"),
    }
    plain, known = (fit(pendulum(), PENDULUM, **given) for given in ({}, held))
    for model in (plain, known):
        assert model.parameters["k"] == pytest.approx(9.0, rel=1e-3)
        assert model.parameters["rest"] == pytest.approx(0.2, abs=2e-3)
        assert model.quality.residual == pytest.approx(0.005, rel=0.05)
        assert model.quality.converged >= 8
    assert known.parameters["lam"] == pytest.approx(0.03, rel=1e-12)
    assert known.intervals["lam"] == pytest.approx((0.03, 0.03), rel=1e-12)
    assert half_width(known, "k") < 1.01 * half_width(plain, "k")
    assert "lam = 0.03 given" in known.provenance["fit"]


def test_time_in_an_equation_is_measured_from_the_record_start() -> None:
    """Fits and later simulations are tested."""
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
def test_unknown_names_in_an_equation_are_taken_as_its_parameters(
    text: str, made: Callable[..., PistonRecord]
) -> None:
    assert resolve_law(text, made("linear")).parameters == MEANT[text]


ASKED_ABOUT = {
    "z'' + k*z = a*force": "add the column, or declare the parameter",
    "z'' + k*z = a*velocity": "write z' instead",
    "z'' + k*z = Pi": "write pi",
    "z'' + k*z = max()": "max",
    "z'' + k*z = sqare(z)": "is not a function",
}


@pytest.mark.parametrize("text", ASKED_ABOUT)
def test_unknown_names_of_laws_and_parameters_are_refused_with_a_suggestion(
    text: str, made: Callable[..., PistonRecord]
) -> None:
    """The error is one line and gives the correct spelling."""
    with pytest.raises(InputError) as caught:
        fit(made("linear"), text)
    assert ASKED_ABOUT[text] in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"parameters": ["omega"]}, "is not a mapping"),
        ({"parameters": {"omege": 1.0}}, "omega"),
        ({"parameters": {"omega": Parameter(-1.0, fixed=True)}}, "parameter omega: its bounds or the law"),
        ({"parameters": {"g0": Parameter(0.0, low=0.0)}}, "parameter g0: its bounds or the law"),
        ({"parameters": {"omega": Parameter([1.0, 2.0], fixed=True)}}, "2 values for 1 records"),
        ({"parameters": {name: Parameter(1.0, fixed=True) for name in LAWS["linear"].parameters}}, "nothing"),
        ({"parameters": {"omega": "fast"}}, "parameter omega: 'fast' is not a quantity"),
        ({"parameters": {"omega": Parameter(low="1 m")}}, "a quantity in rad/s is wanted"),
        ({"parameters": {"omega": "3 Hz"}}, "give the angular frequency, 2 pi times it"),
        ({"loss": "cauchy"}, "'linear', 'soft_l1' or 'huber'"),
        ({"weights": np.ones(3)}, r"one per sample \(2000\)"),
        ({"noise": -1.0}, "positive numbers"),
        ({"options": FitOptions(initial={"speed": 1.0})}, "state at the start"),
        ({"options": FitOptions(drift=True), "intervals": "profile"}, "do not support a drift"),
        ({"seed": -1}, "seed = -1; give an integer from 0 on"),
        ({"test_fraction": "a third"}, "give a fraction from 0 to 0.9"),
        ({"confidence": None}, "give a fraction between 0 and 1"),
        ({"confidence": 0.0}, "give a fraction between 0 and 1"),
        ({"starts": 0}, "integer from 1"),
        ({"test_fraction": 1.0}, "from 0 to 0.9"),
        ({"intervals": "profil"}, "profil"),
        ({"parameters": {"omege": Parameter(per_record=True)}}, "omege"),
    ],
)
def test_unsuitable_options_are_refused(
    made: Callable[..., PistonRecord], options: dict[str, Any], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        fit(made("linear"), "linear", **options)


def test_arguments_that_are_not_records_or_laws_are_refused(made: Callable[..., PistonRecord]) -> None:
    record: Any = made("linear")
    for wrong in (None, [TIME]):
        with pytest.raises(InputError, match="is not a record; give the path of a file"):
            fit(wrong, "linear")
    with pytest.raises(InputError, match="give a name, an equation or a Law"):
        fit(record, 3)
    with pytest.raises(InputError, match="law = 3 cannot be compared; give a name"):
        compare(record, [3])
    assert [row.name for row in compare(record, "linear").rows] == ["linear"]


def test_fit_uses_given_noise_weights_and_initial_state(made: Callable[..., PistonRecord]) -> None:
    record, level = made("linear"), 0.01 * float(made("linear").height.std())
    plain = fit(record, "linear")
    known = fit(record, "linear", noise=2.0 * level)
    for name in plain.parameters:
        assert half_width(known, name) == pytest.approx(2.0 * half_width(plain, name), rel=0.1)
    # Samples of negligible weight do not count, whatever their values.
    spoilt = np.isin(np.arange(2000), np.arange(500, 520))
    weights = np.where(spoilt, 1e-6, 1.0)
    spared = fit(PistonRecord(TIME, record.height + spoilt), "linear", weights=weights)
    assert spared.parameters == pytest.approx(plain.parameters, rel=2e-3)
    still = fit(record, "linear", options=FitOptions(initial="rest"))
    assert still.initial[1] == 0.0
    assert fit(record, "linear", options=FitOptions(initial="free")).initial == plain.initial
    given = fit(record, "linear", options=FitOptions(initial={"height": 1.0, "velocity": 0.0}))
    assert given.initial == pytest.approx((1.0, 0.0), abs=1e-12)


@pytest.mark.parametrize("loss", ["soft_l1", "huber"])
def test_robust_losses_reduce_the_influence_of_outliers(made: Callable[..., PistonRecord], loss: Any) -> None:
    record, random = made("linear"), np.random.default_rng(3)
    height = record.height.copy()
    away = random.choice(2000, 60, replace=False)
    height[away] += random.normal(0.0, 20.0 * 0.01 * height.std(), 60)
    model, clean = fit(PistonRecord(TIME, height), "linear", loss=loss), fit(record, "linear")
    assert_found(clean, model.parameters, 0.6)
    for name in clean.parameters:
        assert half_width(model, name) < 1.5 * half_width(clean, name)


@pytest.mark.long
def test_eight_pendulum_lengths_determine_gravity_and_the_pivot_offset() -> None:
    """Known lengths are given as a list, one per record. Shared parameters are fitted to all records."""
    law = "z'' + c*z' + g/(L + d)*z = 0"
    lengths, records = np.linspace(0.3, 1.5, 8), []
    for seed, length in enumerate(lengths):
        omega = math.sqrt(9.81 / (length + 0.02) - 0.01**2)
        records.append(noisy(TIME[:500], damped_cosine(TIME[:500], 0.1, 0.01, omega), 0.001, seed))
    known = {"g": 9.0, "d": 0.01, "L": Parameter(lengths.tolist(), fixed=True)}
    models = fit(records, law, parameters=known)
    assert_found(models[0], {"g": 9.81, "d": 0.02, "c": 0.02})
    assert [model.parameters["L"] for model in models] == pytest.approx(lengths, rel=1e-12)
    assert models[0].undetermined == ()


def test_a_given_initial_state_is_in_si_units() -> None:
    """It has a height in m and a velocity in m/s, although the record is in mm."""
    time = np.linspace(0.0, 6.0, 2000)
    record = PistonRecord(time, 0.059 + 1.2e-3 * np.exp(-0.8 * time) * np.sin(21.8 * time))
    model = fit(record, "linear", starts=1, options=FitOptions(initial={"height": 0.059, "velocity": 0.026}))
    assert model.initial == pytest.approx((0.059, 0.026), rel=1e-12)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"low": 2.0, "high": 1.0}, "low = 2 and high = 1, but low must be less than high; change them"),
        ({"low": 4, "high": 4}, "both 4; give value=4, fixed=True"),
        ({"value": 3.0, "low": 0.0, "high": 2.0}, "value = 3 lies outside its bounds 0 to 2"),
        ({"value": math.inf}, "value = inf lies outside"),
        ({"value": math.nan}, "value = nan is not a number"),
        ({"value": True}, "True is not a number"),
        ({"fixed": True}, "fixed but has no value"),
        ({"value": [1.0, 2.0]}, "add fixed=True"),
    ],
)
def test_wrong_parameter_values_are_refused(given: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Parameter(**given)


def test_parameter_texts_are_converted_to_the_unit_of_the_law() -> None:
    known = {"k": Parameter("2.5 N/mm", low="1 N/m"), "c": "3 N s/m"}
    law = FORCE_LAWS["linear"]
    found = parameter_settings(law, parameters_by_name(known), 1)
    assert found.start == {"k": 2500.0, "c": 3.0}
    assert found.bounds == {"k": (1.0, math.inf)}
    limits = {"k": Parameter(low="5 N/mm", high=2000.0)}
    with pytest.raises(InputError, match="parameter k: low = 5000 and high = 2000, but low must be less"):
        parameter_settings(law, limits, 1)


def test_parameter_with_lower_bound_zero_is_searched_on_a_logarithmic_scale(
    made: Callable[..., PistonRecord],
) -> None:
    """Without the bound, the start value may have either sign, and the fit finds the same parameters."""
    law, record = "z'' + c*z' + k*z = g", made("linear")
    free, above = (fit(record, law, starts=1, parameters=known) for known in ({}, {"c": Parameter(low=0.0)}))
    assert ("c" in free.law.positive, "c" in above.law.positive) == (False, True)
    assert above.parameters == pytest.approx(free.parameters, rel=1e-4)
    kept = fit(record, "linear", starts=1, parameters={"g0": Parameter(-1.0, fixed=True)})
    assert kept.parameters["g0"] == -1.0


def test_comparison_passes_parameters_only_to_laws_that_have_them(made: Callable[..., PistonRecord]) -> None:
    record = made("linear")
    kept = {"g0": Parameter(-1.0, fixed=True), "beta": Parameter(low=-1.0)}
    rows = compare(record, ["linear", "duffing"], parameters=kept, starts=2).rows
    assert {row.name: row.parameters for row in rows} == {"linear": 2, "duffing": 4}
    with pytest.raises(InputError, match="gO"):
        compare(record, "linear", parameters={"gO": 1.0})
    with pytest.raises(InputError, match="test_records"):
        compare(record, "linear", test_records=[record], parameters={"g0": Parameter(per_record=True)})
