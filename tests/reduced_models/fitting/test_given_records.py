"""Records as users hand them over: files, tables, arrays; each means the same motion."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import compare, fit
from reduced_models.fitting.fit_data import list_of_records

TIME = np.linspace(0.0, 2.0, 2000)
HEIGHT = 0.06 + 1e-3 * np.exp(-0.8 * TIME) * np.cos(21.8 * TIME)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("given") / "lab.csv"
    PistonRecord(TIME, HEIGHT).to_csv(file)
    return file


GIVEN: dict[str, Callable[[Path], Any]] = {
    "name": str,
    "path": Path,
    "pair": lambda _: (TIME, HEIGHT),
    "lists": lambda _: (TIME.tolist(), HEIGHT.tolist()),
    "mapping": lambda _: {"time": TIME, "height": HEIGHT},
    "frame": lambda _: pandas.DataFrame({"time": TIME, "height": HEIGHT}),
}


@pytest.mark.parametrize("form", GIVEN)
def test_one_record_in_any_form(form: str, path: Path) -> None:
    (record,) = list_of_records(GIVEN[form](path))
    assert np.array_equal(record.height, HEIGHT)
    assert len(list_of_records([GIVEN[form](path)] * 3)) == 3


def test_one_record_gives_a_model_and_a_list_gives_several(path: Path) -> None:
    model = fit(str(path), starts=1, test_fraction=0.0)
    assert model.parameters["omega"] == pytest.approx(np.hypot(21.8, 0.8), rel=1e-6)
    assert fit((TIME, HEIGHT), starts=1, test_fraction=0.0).parameters == model.parameters
    assert isinstance(fit([path], starts=1, test_fraction=0.0), tuple)
    assert compare(path, "linear", starts=1).best.law.name == "linear"


def test_a_table_with_a_record_s_own_names_is_in_si_without_a_word() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        PistonRecord.from_table({"time": 10.0 * TIME, "height": 1e3 * HEIGHT})
    with pytest.warns(UserWarning, match="has no unit and is taken for m"):
        PistonRecord.from_table({"time": TIME, "z": 1e3 * HEIGHT})


def test_anything_else_is_refused_with_what_to_give() -> None:
    with pytest.raises(InputError, match=r"give a file's name, \(time, height\), a table, or a PistonRecord"):
        list_of_records(5)


def test_degrees_and_radians_give_one_law() -> None:
    angle = HEIGHT - 0.06
    records = [
        PistonRecord.from_table({"time [s]": TIME, f"angle [{unit}]": size * angle})
        for unit, size in (("deg", np.degrees(1.0)), ("rad", 1.0))
    ]
    models = [fit(record, "linear", starts=2, test_fraction=0.0) for record in records]
    for record, model in zip(records, models, strict=True):
        assert (record.coordinate_unit, model.coordinate_unit) == ("rad", "rad")
        assert model.at_rest is not None
        assert model.at_rest.coordinate_unit == "rad"
        assert model.simulate(TIME).units["velocity"] == "rad/s"
        assert model.parameters == pytest.approx(models[0].parameters, rel=1e-9)
    with pytest.raises(InputError, match="give 'm' or 'rad'"):
        PistonRecord(TIME, angle, coordinate_unit="deg")  # type: ignore[arg-type]  # a user's mistake
