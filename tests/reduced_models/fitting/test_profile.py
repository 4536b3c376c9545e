"""Profile intervals: what they are by definition, and where the linearisation goes wrong."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
import pytest
from scipy.stats import t as student

from granular import PistonRecord
from reduced_models import Parameter, ReducedModel, fit
from reduced_models.laws import LAWS
from reduced_models.laws.solution import solve_law

TIME = np.linspace(0.0, 10.0, 2000)  # as many as elsewhere: their code is compiled already


def quiet(record: Any, law: str, **options: Any) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fit(record, law, **({"test_fraction": 0.0, "starts": 1} | options))


def weakly_damped(seed: int, lam: float = 0.02, noise: float = 0.63) -> PistonRecord:
    """A swing of ten time units in so much noise that the damping is hardly seen."""
    clean = solve_law(LAWS["linear"], TIME, 0.0, 0.0, (lam, 1.05, -1.0), 1.0).z
    random = np.random.default_rng(seed)
    return PistonRecord(TIME, clean + random.normal(0.0, noise * clean.std(), len(TIME)))


def squares(model: ReducedModel) -> float:
    return model.quality.samples * model.quality.residual**2


def profile_t(record: PistonRecord, model: ReducedModel, name: str, value: float) -> float:
    """By a fit of its own with the parameter held in place."""
    held = quiet(record, model.law.name, parameters={name: Parameter(low=value, high=value * (1.0 + 1e-9))})
    freedom = len(record) - len(model.parameters) - 2
    variance = squares(model) * model.quality.correlation / freedom
    return math.sqrt((squares(held) - squares(model)) / variance)


def test_it_agrees_with_the_linearisation_where_that_is_right(made: Any) -> None:
    record = made("linear")
    linear, profile = (quiet(record, "linear", intervals=how) for how in ("linear", "profile"))
    assert profile.parameters == linear.parameters
    for name, (low, high) in linear.intervals.items():
        assert profile.intervals[name] == pytest.approx((low, high), abs=0.02 * (high - low))
    assert "profile" in profile.provenance["fit"]


def test_the_sum_of_squares_rises_to_the_quantile_at_the_ends() -> None:
    """Checked by fits with the parameter held there, of the damping and of the frequency."""
    record = weakly_damped(1)
    model = quiet(record, "linear", intervals="profile")
    quantile = student.ppf(0.975, len(record) - 5)
    for name in ("lam", "omega"):
        for end in model.intervals[name]:
            assert profile_t(record, model, name, end) == pytest.approx(quantile, rel=0.02)
    # The same cannot be said of the linearisation, on the logarithm of a damping near 0.
    linear = quiet(record, "linear")
    low, high = (profile_t(record, linear, "lam", end) for end in linear.intervals["lam"])
    assert low < 0.95 * quantile
    assert high > 1.05 * quantile


def test_a_damping_that_may_be_none_has_no_least_value() -> None:
    """Its logarithm goes to minus infinity; the linearisation does not see that."""
    record = weakly_damped(0, lam=5e-3, noise=0.63)
    linear, profile = (quiet(record, "linear", intervals=how) for how in ("linear", "profile"))
    assert profile.intervals["lam"][0] == 0.0
    assert profile.intervals["lam"][1] < 0.02
    assert linear.intervals["lam"][0] > 0.0
    assert linear.intervals["lam"][1] > 0.02


def test_intervals_keep_to_the_bounds() -> None:
    """An end at the bound, from a fit within and from one that lies at the bound."""
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
def test_what_the_data_leave_open_has_no_end() -> None:
    """A linear record tells the damping at rest: alpha and the scale trade places for ever."""
    time = np.linspace(0.0, 3.0, 300)
    swing = 1.2e-3 * np.exp(-0.8 * time) * np.cos(21.8 * time)
    noise = np.random.default_rng(1).normal(0.0, 1e-5, len(time))
    record = PistonRecord(time, 0.059 + swing + noise)
    model = quiet(record, "van-der-pol-like", intervals="profile")
    assert model.intervals["alpha"][0] == 0.0
    assert model.intervals["alpha"][1] == math.inf
    low, high = model.intervals["omega"]
    assert low < math.hypot(21.8, 0.8) < high
    assert high - low < 0.2


def test_the_sum_of_squares_of_several_records_rises_to_the_quantile() -> None:
    """Profile a damping that they share, by fits to both with it held there."""
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


@pytest.mark.long  # quick: the shared interval above, several records in `test_several`
def test_several_records_share_an_interval(made: Any) -> None:
    """Shared parameters have one interval; own ones have their own."""
    records = [made("linear", seed=seed, start=start) for seed, start in ((1, 1.0), (2, 2.0))]
    models = quiet(records, "linear", intervals="profile", parameters={"g0": Parameter(per_record=True)})
    linear = quiet(records, "linear", parameters={"g0": Parameter(per_record=True)})
    assert models[0].intervals["omega"] == models[1].intervals["omega"]
    for mine, other in zip(models, linear, strict=True):
        for name, (low, high) in other.intervals.items():
            assert mine.intervals[name] == pytest.approx((low, high), abs=0.03 * (high - low))


@pytest.mark.long
def test_it_covers_better_where_the_law_is_not_linear() -> None:
    """A damping of a third of its own standard error, in 200 records; 95 % intervals."""
    truth, covered = 0.002, {"linear": [], "profile": []}
    for seed in range(200):
        record = weakly_damped(seed, lam=truth, noise=0.63)
        for how, found in covered.items():
            low, high = quiet(record, "linear", intervals=how).intervals["lam"]
            found.append(low <= truth <= high)
    assert np.mean(covered["profile"]) >= 0.93
    assert np.mean(covered["profile"]) > np.mean(covered["linear"]) + 0.03
