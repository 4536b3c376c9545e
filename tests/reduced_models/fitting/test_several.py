"""Several records at once, own parameters, bounds, gaps."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import Parameter, fit
from reduced_models.fitting.fit_data import data_of_record
from reduced_models.fitting.problem import FitProblem
from reduced_models.laws import LAWS
from reduced_models.laws.solution import solve_law
from reduced_models.records.derivatives import noise_level

TIME = np.linspace(0.0, 40.0, 2000)


def linear(g0: float, start: float, seed: int) -> PistonRecord:
    found = solve_law(LAWS["linear"], TIME, start, 0.0, (0.05, 1.05, g0), 1.0)
    noise = np.random.default_rng(seed).normal(0.0, 0.01, len(TIME))
    return PistonRecord(TIME + 3.0 * seed, found.z + noise)


def test_shared_and_own_parameters() -> None:
    """Two masses on one spring: frequency and damping are shared, the load is not."""
    records = [linear(-1.0, 1.0, 1), linear(0.5, 3.0, 2)]
    models = fit(records, "linear", parameters={"g0": Parameter(per_record=True)})
    assert [model.parameters["g0"] for model in models] == pytest.approx([-1.0, 0.5], rel=0.01)
    for name, value in (("lam", 0.05), ("omega", 1.05)):
        assert models[0].parameters[name] == models[1].parameters[name]
        assert models[0].parameters[name] == pytest.approx(value, rel=0.01)
    assert all(model.quality.relative < 0.03 for model in models)
    # Both models know the heights of both records.
    low = min(float(record.height.min()) for record in records)
    high = max(float(record.height.max()) for record in records)
    assert [model.domain["height"] for model in models] == [(low, high)] * 2
    # What two records tell together, each tells less sharply.
    alone = fit(records[0], "linear")
    together, single = (np.diff(model.intervals["omega"])[0] for model in (models[0], alone))
    assert together < 0.7 * single
    with pytest.warns(UserWarning, match="times the record's noise"):
        wrong = fit(records, "linear")
    assert wrong[0].quality.relative > 5.0 * models[0].quality.relative


def test_one_record_is_fitted_as_one_of_several() -> None:
    record = linear(-1.0, 1.0, 1)
    alone, (listed,) = fit(record, "linear", starts=4), fit([record], "linear", starts=4)
    assert listed.parameters == alone.parameters
    assert listed.intervals == alone.intervals
    assert listed.quality == alone.quality


def test_a_record_s_entries_are_the_shared_ones_and_its_own() -> None:
    data = data_of_record(LAWS["linear"], linear(-1.0, 1.0, 1), 0.3)
    assert data.entries.tolist() == [0, 1, 2, 3, 4]
    first, second = (dataclasses.replace(data, own=("omega",), number=number) for number in (0, 1))
    assert first.entries.tolist() == [0, 2, 1, 3, 4]
    assert second.entries.tolist() == [0, 5, 1, 6, 7]
    vectors = [np.arange(5.0), 10.0 + np.arange(5.0)]
    joint = FitProblem((first, second)).joint_vector(vectors)
    np.testing.assert_array_equal(joint, [0.0, 2.0, 1.0, 3.0, 4.0, 11.0, 13.0, 14.0])


def test_the_same_record_twice_halves_the_variance() -> None:
    record = linear(-1.0, 1.0, 1)
    one = fit(record, "linear")
    two = fit([record, record], "linear")[0]
    assert two.parameters == pytest.approx(one.parameters, rel=1e-5)
    for name in one.parameters:
        ratio = np.diff(two.intervals[name])[0] / np.diff(one.intervals[name])[0]
        assert ratio == pytest.approx(np.sqrt(0.5), rel=0.01)


def test_bounds_hold_and_are_noted(made: Any) -> None:
    record = made("linear")
    free = fit(record, "linear", parameters={"omega": Parameter(low=0.5, high=2.0)})
    assert free.parameters == pytest.approx(fit(record, "linear").parameters, rel=1e-6)
    assert not any("bound" in note for note in free.notes)
    half_open = fit(record, "linear", parameters={"omega": Parameter(low=0.5)})
    assert not any("bound" in note for note in half_open.notes)
    with pytest.warns(UserWarning, match="omega = 1.06 lies at its bound"):
        held = fit(record, "linear", parameters={"omega": Parameter(low=1.06, high=2.0)})
    assert held.parameters["omega"] == pytest.approx(1.06, rel=1e-12)
    for name, limits in (("omega", Parameter(low=-2.0, high=-1.0)), ("omege", Parameter(low=0.0))):
        with pytest.raises(InputError, match=f"{name}"):
            fit(record, "linear", parameters={name: limits})


def test_irregular_samples_with_a_gap(made: Any) -> None:
    """Two thirds of the samples at random, none of them over a whole period."""
    record, random = made("duffing"), np.random.default_rng(4)
    kept = (random.uniform(size=2000) < 0.67) & ((record.time < 12.0) | (record.time > 17.0))
    thin = PistonRecord(record.time[kept], record.height[kept])
    model = fit(thin, "duffing", starts=1)
    for name, value in made.true["duffing"].items():
        assert model.parameters[name] == pytest.approx(value, rel=0.01)
    assert model.quality.noise == pytest.approx(0.01 * record.height.std(), rel=0.2)
    assert model.quality.test_error < 0.015


def test_noise_level_heeds_the_times() -> None:
    random = np.random.default_rng(1)
    time = np.sort(random.uniform(0.0, 10.0, 5000))
    smooth = np.sin(time)
    assert noise_level(smooth, time) < 1e-5
    noisy = smooth + random.normal(0.0, 0.02, 5000)
    assert noise_level(noisy, time) == pytest.approx(0.02, rel=0.05)


def test_bad_arguments(made: Any) -> None:
    record = made("linear")
    for options in ({"parameters": {"omege": Parameter(per_record=True)}}, {"intervals": "profil"}):
        with pytest.raises(InputError):
            fit(record, "linear", **options)
    with pytest.raises(InputError, match="no record"):
        fit([], "linear")
