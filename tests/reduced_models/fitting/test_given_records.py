"""Records in the forms that users pass to fits: files, tables, arrays, or several at once."""

import dataclasses
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import Parameter, compare, fit
from reduced_models.fitting.fit_data import fit_data_of_record, list_of_records
from reduced_models.fitting.problem import FitProblem
from reduced_models.laws import LAWS
from reduced_models.laws.solution import solve_law
from reduced_models.records.derivatives import noise_standard_deviation
from tests.reduced_models.made import half_width, noisy

TIME = np.linspace(0.0, 2.0, 2000)
HEIGHT = 0.06 + 1e-3 * np.exp(-0.8 * TIME) * np.cos(21.8 * TIME)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("given") / "lab.csv"
    PistonRecord(TIME, HEIGHT).to_csv(file)
    return file


def _series(_: Path) -> Any:
    return pandas.Series(HEIGHT, index=pandas.to_timedelta(TIME, unit="s"))


def _array(_: Path) -> Any:
    import xarray

    return xarray.DataArray(HEIGHT, dims="time", coords={"time": TIME}, name="height")


GIVEN: dict[str, Callable[[Path], Any]] = {
    "name": str,
    "path": Path,
    "pair": lambda _: (TIME, HEIGHT),
    "lists": lambda _: (TIME.tolist(), HEIGHT.tolist()),
    "mapping": lambda _: {"time": TIME, "height": HEIGHT},
    "frame": lambda _: pandas.DataFrame({"time": TIME, "height": HEIGHT}),
    "series": _series,
    "array": _array,
}


@pytest.mark.parametrize("form", GIVEN)
def test_all_forms_of_a_record_give_the_same_fit(form: str, path: Path) -> None:
    (record,) = list_of_records(GIVEN[form](path))
    assert np.array_equal(record.height, HEIGHT)
    assert len(list_of_records([GIVEN[form](path)] * 3)) == 3


def test_a_fit_of_one_record_gives_one_model_and_a_fit_of_a_list_gives_several(path: Path) -> None:
    model = fit(str(path), starts=1, test_fraction=0.0)
    assert model.parameters["omega"] == pytest.approx(np.hypot(21.8, 0.8), rel=1e-6)
    assert fit((TIME, HEIGHT), starts=1, test_fraction=0.0).parameters == model.parameters
    assert isinstance(fit([path], starts=1, test_fraction=0.0), tuple)
    assert compare(path, "linear", starts=1).best.law.name == "linear"


def test_table_with_standard_column_names_is_taken_as_si_without_a_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        PistonRecord.from_table({"time": 10.0 * TIME, "height": 1e3 * HEIGHT})
    with pytest.warns(UserWarning, match="has no unit and is taken as m"):
        PistonRecord.from_table({"time": TIME, "z": 1e3 * HEIGHT})


def test_error_for_an_object_that_is_not_a_record_lists_the_accepted_forms() -> None:
    with pytest.raises(
        InputError, match=r"give the path of a file, \(time, height\), a table, or a PistonRecord"
    ):
        list_of_records(5)


def test_fits_of_an_angle_in_degrees_and_in_radians_give_the_same_law() -> None:
    angle = HEIGHT - 0.06
    records = [
        PistonRecord.from_table({"time [s]": TIME, f"angle [{unit}]": size * angle})
        for unit, size in (("deg", np.degrees(1.0)), ("rad", 1.0))
    ]
    models = [fit(record, "linear", starts=2, test_fraction=0.0) for record in records]
    for record, model in zip(records, models, strict=True):
        assert (record.coordinate_unit, model.coordinate_unit) == ("rad", "rad")
        assert model.at_rest.coordinate_unit == "rad"
        assert model.simulate(TIME).units["velocity"] == "rad/s"
        assert model.parameters == pytest.approx(models[0].parameters, rel=1e-9)
    with pytest.raises(InputError, match="use 'm' or 'rad'"):
        PistonRecord(TIME, angle, coordinate_unit="deg")  # type: ignore[arg-type]  # a user's mistake


NATURAL_TIME = np.linspace(0.0, 40.0, 2000)


def linear(g0: float, start: float, seed: int) -> PistonRecord:
    found = solve_law(LAWS["linear"], NATURAL_TIME, start, 0.0, (0.05, 1.05, g0), 1.0)
    noise = np.random.default_rng(seed).normal(0.0, 0.01, len(NATURAL_TIME))
    return PistonRecord(NATURAL_TIME + 3.0 * seed, found.z + noise)


def test_a_fit_of_two_records_can_have_shared_and_separate_parameters() -> None:
    """Two masses hang on one spring: frequency and damping are shared, the equilibrium under the load
    is not.
    """
    records = [linear(-1.0, 1.0, 1), linear(0.5, 3.0, 2)]
    models = fit(records, "linear", parameters={"g0": Parameter(per_record=True)})
    assert [model.parameters["g0"] for model in models] == pytest.approx([-1.0, 0.5], rel=0.01)
    for name, value in (("lam", 0.05), ("omega", 1.05)):
        assert models[0].parameters[name] == models[1].parameters[name] == pytest.approx(value, rel=0.01)
    assert all(model.quality.relative < 0.03 for model in models)
    # Both models hold the range of heights of both records.
    heights = np.concatenate([record.height for record in records])
    assert [model.domain["height"] for model in models] == [(heights.min(), heights.max())] * 2
    # One record alone determines it less precisely than both together.
    assert half_width(models[0], "omega") < 0.7 * half_width(fit(records[0], "linear"), "omega")
    with pytest.warns(UserWarning, match="times the record's noise"):
        wrong = fit(records, "linear")
    assert wrong[0].quality.relative > 5.0 * models[0].quality.relative


def test_a_list_of_one_record_gives_the_same_fit_as_the_record() -> None:
    record = linear(-1.0, 1.0, 1)
    alone, (listed,) = fit(record, "linear", starts=1), fit([record], "linear", starts=1)
    assert listed.parameters == alone.parameters
    assert listed.intervals == alone.intervals
    assert listed.quality == alone.quality


def test_the_parameter_vector_holds_shared_entries_before_separate_ones() -> None:
    data = fit_data_of_record(LAWS["linear"], linear(-1.0, 1.0, 1), 0.3)
    assert data.joint_vector_indices.tolist() == [0, 1, 2, 3, 4]
    first, second = (dataclasses.replace(data, per_record=("omega",), number=number) for number in (0, 1))
    assert first.joint_vector_indices.tolist() == [0, 2, 1, 3, 4]
    assert second.joint_vector_indices.tolist() == [0, 5, 1, 6, 7]
    vectors = [np.arange(5.0), 10.0 + np.arange(5.0)]
    joint = FitProblem((first, second)).joint_vector(vectors)
    np.testing.assert_array_equal(joint, [0.0, 2.0, 1.0, 3.0, 4.0, 11.0, 13.0, 14.0])


def test_fitting_the_same_record_twice_halves_the_variance_of_shared_parameters() -> None:
    record = linear(-1.0, 1.0, 1)
    one, two = fit(record, "linear"), fit([record, record], "linear")[0]
    assert two.parameters == pytest.approx(one.parameters, rel=1e-5)
    for name in one.parameters:
        assert half_width(two, name) == pytest.approx(np.sqrt(0.5) * half_width(one, name), rel=0.01)


def test_a_parameter_at_its_bound_is_noted(made: Any) -> None:
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


def test_fit_of_irregular_samples_with_a_gap_recovers_the_parameters(made: Any) -> None:
    """Two thirds of the samples are kept at random, and none in one complete period."""
    record, random = made("duffing"), np.random.default_rng(4)
    kept = (random.uniform(size=2000) < 0.67) & ((record.time < 12.0) | (record.time > 17.0))
    thin = PistonRecord(record.time[kept], record.height[kept])
    model = fit(thin, "duffing", starts=1)
    for name, value in made.true["duffing"].items():
        assert model.parameters[name] == pytest.approx(value, rel=0.01)
    assert model.quality.noise == pytest.approx(0.01 * record.height.std(), rel=0.2)
    assert model.quality.test_error < 0.015


def test_the_estimated_noise_level_accounts_for_the_sample_times() -> None:
    time = np.sort(np.random.default_rng(1).uniform(0.0, 10.0, 5000))
    assert noise_standard_deviation(np.sin(time), time) < 1e-5
    assert noise_standard_deviation(noisy(time, np.sin(time), 0.02).height, time) == pytest.approx(
        0.02, rel=0.05
    )


def test_empty_list_of_records_is_refused() -> None:
    with pytest.raises(InputError, match="list of records is empty"):
        fit([], "linear")
