"""Intervals: profiles, undetermined parameters, noise that grows with the speed, and calibrations."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import t as student

from reduced_models import Parameter, PistonRecord, ReducedModel, fit
from reduced_models.fitting.residual_diagnostics import fit_autoregression, gradient_covariance
from reduced_models.fitting.uncertainty import (
    covariance_by_rounding_errors,
    marginal_information,
    sandwich_covariance,
)
from reduced_models.laws.catalogue import law_named
from reduced_models.laws.solution import solve_law
from tests.reduced_models.made import damped_cosine, half_width, noisy

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")

TIME = np.linspace(0.0, 10.0, 2000)  # as many as elsewhere: their code is compiled already


def quiet(record: Any, law: str, **options: Any) -> Any:
    return fit(record, law, **({"test_fraction": 0.0, "starts": 1} | options))


def weakly_damped(seed: int, lam: float = 0.02) -> PistonRecord:
    """Return an oscillation over ten time units, in noise that nearly hides the damping."""
    clean = solve_law(law_named("linear"), TIME, 0.0, 0.0, (lam, 1.05, -1.0), 1.0).z
    return noisy(TIME, clean, 0.63 * clean.std(), seed)


def squares(model: ReducedModel) -> float:
    return model.quality.samples * model.quality.residual**2


def profile_t(record: PistonRecord, model: ReducedModel, name: str, value: float) -> float:
    """Return Student's t of a parameter value, from a separate fit with the parameter held."""
    held = quiet(record, model.law.name, parameters={name: Parameter(low=value, high=value * (1.0 + 1e-9))})
    freedom = len(record) - len(model.parameters) - 2
    variance = squares(model) * model.quality.correlation / freedom
    return math.sqrt((squares(held) - squares(model)) / variance)


def test_profile_interval_agrees_with_the_linearisation_for_a_linear_problem(made: Any) -> None:
    record = made("linear")
    linear, profile = (quiet(record, "linear", intervals=how) for how in ("linear", "profile"))
    assert profile.parameters == linear.parameters
    for name, (low, high) in linear.intervals.items():
        assert profile.intervals[name] == pytest.approx((low, high), abs=0.02 * (high - low))
    assert "profile" in profile.provenance["fit"]


def test_at_the_ends_of_a_profile_interval_the_sum_of_squares_rises_to_the_quantile() -> None:
    """The rise is computed by fits with damping or frequency held at the ends."""
    record = weakly_damped(1)
    model = quiet(record, "linear", intervals="profile")
    quantile = student.ppf(0.975, len(record) - 5)
    for name in ("lam", "omega"):
        for end in model.intervals[name]:
            assert profile_t(record, model, name, end) == pytest.approx(quantile, rel=0.02)
    # This does not hold for the linearisation, on the logarithm of a damping near 0.
    linear = quiet(record, "linear")
    low, high = (profile_t(record, linear, "lam", end) for end in linear.intervals["lam"])
    assert low < 0.95 * quantile
    assert high > 1.05 * quantile


def test_damping_compatible_with_zero_has_no_lower_limit() -> None:
    """The profile extends to a logarithm of minus infinity, which the linearisation does not show."""
    record = weakly_damped(0, lam=5e-3)
    linear, profile = (quiet(record, "linear", intervals=how) for how in ("linear", "profile"))
    assert profile.intervals["lam"][0] == 0.0
    assert profile.intervals["lam"][1] < 0.02
    assert linear.intervals["lam"][0] > 0.0
    assert linear.intervals["lam"][1] > 0.02


def test_confidence_intervals_end_at_the_bounds_of_parameters() -> None:
    """Fits within the bounds and at a bound are tested."""
    record = weakly_damped(1)
    free = quiet(record, "linear", intervals="profile")
    bound = 0.5 * (free.parameters["lam"] + free.intervals["lam"][0])
    inside = quiet(record, "linear", intervals="profile", parameters={"lam": Parameter(low=bound, high=1.0)})
    assert inside.intervals["lam"][0] == pytest.approx(bound, rel=1e-9)
    assert inside.intervals["lam"][1] == pytest.approx(free.intervals["lam"][1], rel=1e-3)
    bound = 0.5 * (free.parameters["lam"] + free.intervals["lam"][1])
    at_bound = quiet(
        record, "linear", intervals="profile", parameters={"lam": Parameter(low=bound, high=1.0)}
    )
    assert at_bound.parameters["lam"] == pytest.approx(bound, rel=1e-9)
    assert at_bound.intervals["lam"][0] == pytest.approx(bound, rel=1e-9)
    assert at_bound.intervals["lam"][1] > bound


@pytest.mark.long
def test_interval_of_an_undetermined_parameter_is_unbounded() -> None:
    """A linear record determines only the damping at equilibrium.

    The law's parameter alpha and the scale of the height are therefore fully correlated.
    """
    time = np.linspace(0.0, 3.0, 300)
    record = noisy(time, 0.059 + damped_cosine(time, 1.2e-3), 1e-5, 1)
    model = quiet(record, "van-der-pol-like", intervals="profile")
    assert model.intervals["alpha"] == (0.0, math.inf)
    low, high = model.intervals["omega"]
    assert low < math.hypot(21.8, 0.8) < high
    assert high - low < 0.2


def test_profile_interval_of_a_parameter_shared_by_several_records_ends_at_the_quantile() -> None:
    """The profile of a shared damping is compared with joint fits in which the damping is held."""
    records = [weakly_damped(seed) for seed in (1, 2)]
    models = quiet(records, "linear", intervals="profile", parameters={"g0": Parameter(per_record=True)})
    assert models[0].intervals["lam"] == models[1].intervals["lam"]
    freedom = sum(map(len, records)) - 8  # damping, frequency; two loads, heights and velocities
    least = sum(map(squares, models))
    variance = least * np.mean([one.quality.correlation for one in models]) / freedom
    end = models[0].intervals["lam"][1]
    held = quiet(
        records,
        "linear",
        parameters={"g0": Parameter(per_record=True), "lam": Parameter(low=end, high=end * (1.0 + 1e-9))},
    )
    rise = math.sqrt((sum(map(squares, held)) - least) / variance)
    assert rise == pytest.approx(student.ppf(0.975, freedom), rel=0.02)


SAMPLES, SIZE = 400, 4


def _correlated_noise(reach: float) -> np.ndarray:
    times = np.arange(SAMPLES)
    return np.asarray(np.exp(-np.abs(times[:, None] - times[None, :]) / reach))


@pytest.mark.parametrize("independent_part", [0.0, 1e-9, 1e-8, 1e-7])
@pytest.mark.parametrize("seed", range(20))
def test_undetermined_parameter_combinations_never_get_narrow_intervals(
    seed: int, independent_part: float
) -> None:
    random = np.random.default_rng(seed)
    phases = np.linspace(0.0, 20.0, SAMPLES)
    slopes = np.stack([np.sin(k * phases) for k in range(1, SIZE + 1)], axis=1)
    slopes[:, -1] = slopes[:, :-1] @ random.normal(size=SIZE - 1) + independent_part * slopes[:, -1]
    slopes *= 10.0 ** random.uniform(-4.0, 4.0, SIZE)
    noise = _correlated_noise(60.0)
    found = sandwich_covariance(slopes.T @ slopes, slopes.T @ noise @ slopes, 1.0)
    # Lower bound of the error along the last parameter: white residuals of that variance.
    least = 1.0 / np.linalg.norm(slopes[:, -1]) ** 2
    assert found[-1, -1] > 1e5**2 * least
    assert (np.diag(found) > 0.0).all()


def test_sandwich_formula_gives_the_covariance_of_least_squares_under_correlated_noise() -> None:
    slopes = np.random.default_rng(1).normal(size=(SAMPLES, SIZE))
    noise = _correlated_noise(5.0)
    inverse = np.linalg.inv(slopes.T @ slopes)
    exact = inverse @ slopes.T @ noise @ slopes @ inverse
    assert_allclose(sandwich_covariance(slopes.T @ slopes, slopes.T @ noise @ slopes, 1.0), exact, rtol=1e-9)


def test_marginal_information_is_the_inverse_of_the_marginal_covariance_matrix() -> None:
    slopes = np.random.default_rng(2).normal(size=(SAMPLES, SIZE))
    normal, asked = slopes.T @ slopes, np.array([0, 2])
    free = np.ones(SIZE, dtype=bool)
    exact = np.linalg.inv(np.linalg.inv(normal)[np.ix_(asked, asked)])
    assert_allclose(marginal_information(normal, asked, free), exact, rtol=1e-10)


def test_an_initial_state_without_influence_does_not_change_the_information_matrix() -> None:
    slopes = np.random.default_rng(3).normal(size=(SAMPLES, SIZE))
    slopes[:, -1] = 0.0
    normal, asked = slopes.T @ slopes, np.array([0, 1])
    without = marginal_information(normal[:-1, :-1], asked, np.ones(SIZE - 1, dtype=bool))
    assert_allclose(marginal_information(normal, asked, np.ones(SIZE, dtype=bool)), without, rtol=1e-10)


COVERAGE_TIME = np.arange(0.0, 12.0, 0.01)
OMEGA = math.tau
LAWS = {
    "viscous-coulomb": {"lam": 0.02 * OMEGA, "friction": 0.05 * OMEGA**2 / 4.0, "omega": OMEGA, "g0": 0.0},
    "coulomb": {"friction": 0.08 * OMEGA**2 / 4.0, "omega": OMEGA, "g0": 0.0},
}


def record(law: str, disturbance: str, seed: int) -> PistonRecord:
    """Return a free motion from 1 m with clock jitter of 1.5 ms, rounding to 0.1 m, or white noise."""
    random, values = np.random.default_rng(seed), tuple(LAWS[law].values())
    time, noise = COVERAGE_TIME, 3e-3 if disturbance == "white" else 1e-4
    if disturbance == "jitter":
        moments = COVERAGE_TIME + np.append(0.0, random.normal(0.0, 1.5e-3, len(COVERAGE_TIME) - 1))
        time = np.maximum.accumulate(moments + 1e-9 * np.arange(len(COVERAGE_TIME)))
    height = solve_law(law_named(law), time, 1.0, 0.0, values, 1.0).z
    height = height + random.normal(0.0, noise, len(COVERAGE_TIME))
    if disturbance == "rounding":
        shift = 0.1 * random.uniform()
        height = np.round((height + shift) / 0.1) * 0.1 - shift
    return PistonRecord(COVERAGE_TIME, height)


@pytest.mark.long
@pytest.mark.parametrize("disturbance", ["white", "jitter", "rounding"])
@pytest.mark.parametrize("law", LAWS)
def test_intervals_contain_the_true_values_under_jitter_rounding_and_white_noise(
    law: str, disturbance: str
) -> None:
    """Tested for 30 records; an earlier version assumed white noise of constant size."""
    count, held = 30, dict.fromkeys(LAWS[law], 0)
    for seed in range(count):
        model = fit(record(law, disturbance, seed), law, starts=1, test_fraction=0.0)
        for name, value in LAWS[law].items():
            low, high = model.intervals[name]
            held[name] += low <= value <= high
    assert min(held.values()) >= 0.85 * count


def test_covariance_of_the_gradient_is_correct_for_noise_that_grows_with_the_speed() -> None:
    """The covariance is compared with many random samples of the noise."""
    random, count = np.random.default_rng(0), 2000
    phase = 0.1 * np.arange(count)
    slopes, level = np.stack([np.cos(phase), np.sin(phase)], axis=1), np.abs(np.sin(phase))
    noise = level[:, None] * random.normal(size=(count, 400))
    seen = np.cov(slopes.T @ noise)
    estimated = np.mean(
        [gradient_covariance(slopes, values, fit_autoregression(values), level) for values in noise.T[:20]],
        axis=0,
    )
    np.testing.assert_allclose(np.diag(estimated), np.diag(seen), rtol=0.2)
    assert estimated[1, 1] > 2.0 * estimated[0, 0]


def test_equal_successive_readings_share_one_rounding_error() -> None:
    """Readings share their error only while the motion rests or turns.

    Where the motion crosses a rounding level, the errors have both signs.
    """
    slopes = np.ones((14, 1))
    standing = np.append(np.arange(6.0), np.full(8, 6.0))
    assert covariance_by_rounding_errors(slopes, standing)[0, 0] == pytest.approx((8.0**2 - 8.0) / 12.0)
    passing = np.repeat(np.arange(7.0), 2)
    assert covariance_by_rounding_errors(slopes, passing)[0, 0] == pytest.approx(2.0 * (4.0 - 2.0) / 12.0)
    turning = np.repeat([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 4.0], 2)
    assert covariance_by_rounding_errors(slopes, turning)[0, 0] == pytest.approx(3.0 * (4.0 - 2.0) / 12.0)
    smooth = np.random.default_rng(0).normal(size=14)
    assert covariance_by_rounding_errors(slopes, smooth)[0, 0] == 0.0


VOLT_TIME = np.arange(2000) / 1000.0
VOLT_OMEGA = 2.0 * np.pi * 4.1
NOISE = np.random.default_rng(1).normal(0.0, 3e-5, len(VOLT_TIME))
HEIGHT = 0.06 + damped_cosine(VOLT_TIME, 3e-3, 0.05 * VOLT_OMEGA, VOLT_OMEGA) + NOISE
RAW = HEIGHT / 2.5e-3 + 2.5


def read(scale: str, zero: str = "2.5 V") -> PistonRecord:
    """Return the record of a sensor in volts."""
    table = {"time [s]": VOLT_TIME, "height [V]": RAW}
    return PistonRecord.from_table(table, scale={"height": scale}, zero={"height": zero})


def test_calibration_uncertainty_of_a_parameter_is_its_change_under_another_sensor_scale() -> None:
    plain, wide, other = (
        fit(read(scale), "duffing", starts=1) for scale in ("2.5 mm/V", "2.5 +- 0.02 mm/V", "2.52 mm/V")
    )
    quantile = 1.9608
    for name, value in plain.parameters.items():
        expected = np.hypot(half_width(plain, name), quantile * (other.parameters[name] - value))
        assert half_width(wide, name) == pytest.approx(expected, rel=0.03), name
    assert half_width(wide.at_rest, "height") == pytest.approx(quantile * 0.06 * 0.008, rel=0.03)
    assert wide.at_rest.intervals["period"] == pytest.approx(plain.at_rest.intervals["period"], rel=1e-6)


def test_profile_intervals_include_the_calibration_uncertainty() -> None:
    linear, profiled = (
        fit(read("2.5 +- 0.02 mm/V"), "linear", intervals=how) for how in ("linear", "profile")
    )
    assert half_width(profiled, "g0") == pytest.approx(half_width(linear, "g0"), rel=0.1)


def test_calibration_error_of_a_sensor_shared_by_several_records_does_not_average_out() -> None:
    record = read("2.5 mm/V", "2.5 +- 0.2 V")
    (alone,), together = (fit([record] * count, "linear") for count in (1, 2))
    assert half_width(together[0], "g0") == pytest.approx(half_width(alone, "g0"), rel=1e-3)
