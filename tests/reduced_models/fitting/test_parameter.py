"""Values and limits of parameters: what they may be, and what a fit makes of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import FitOptions, Parameter, compare, fit
from reduced_models.fitting.parameter import as_parameters, parameter_settings
from reduced_models.laws import FORCE_LAWS, LAWS


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"low": 2.0, "high": 1.0}, "low = 2 is above high = 1; give them in order"),
        ({"low": 4, "high": 4}, "both 4; give value=4, fixed=True"),
        ({"value": 3.0, "low": 0.0, "high": 2.0}, "value = 3 lies outside 0 to 2"),
        ({"value": math.inf}, "value = inf lies outside"),
        ({"value": math.nan}, "value = nan is no number"),
        ({"value": True}, "True is no number"),
        ({"fixed": True}, "without a value"),
        ({"value": [1.0, 2.0]}, "add fixed=True"),
    ],
)
def test_what_no_parameter_is(given: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Parameter(**given)


def test_texts_are_in_the_unit_of_the_law() -> None:
    known = {"k": Parameter("2.5 N/mm", low="1 N/m"), "c": "3 N s/m"}
    law = FORCE_LAWS["linear"]
    found = parameter_settings(law, as_parameters(known), 1)
    assert found.start == {"k": 2500.0, "c": 3.0}
    assert found.bounds == {"k": (1.0, math.inf)}
    limits = {"k": Parameter(low="5 N/mm", high=2000.0)}
    with pytest.raises(InputError, match="parameter k: low = 5000 is above high = 2000"):
        parameter_settings(law, limits, 1)


def test_a_parameter_from_zero_on_is_searched_by_its_logarithm(made: Callable[..., PistonRecord]) -> None:
    """Whatever sign the law's own start values have."""
    free = fit(made("duffing"), "duffing", starts=4)
    assert "beta" not in LAWS["duffing"].positive
    above = fit(made("duffing"), "duffing", starts=4, parameters={"beta": Parameter(low=0.0)})
    assert "beta" in above.law.positive
    assert above.parameters == pytest.approx(free.parameters, rel=1e-5)
    kept = fit(made("linear"), "linear", starts=1, parameters={"g0": Parameter(-1.0, fixed=True)})
    assert kept.parameters["g0"] == -1.0


def test_a_comparison_takes_what_its_laws_have(made: Callable[..., PistonRecord]) -> None:
    record = made("linear")
    kept = {"g0": Parameter(-1.0, fixed=True), "beta": Parameter(low=-1.0)}
    rows = compare(record, ["linear", "duffing"], parameters=kept, starts=2).rows
    assert {row.name: row.parameters for row in rows} == {"linear": 2, "duffing": 4}
    with pytest.raises(InputError, match="gO"):
        compare(record, "linear", parameters={"gO": 1.0})
    with pytest.raises(InputError, match="test_records"):
        compare(record, "linear", test_records=[record], parameters={"g0": Parameter(per_record=True)})


def test_options_that_are_none() -> None:
    wrong: Any = "cubic"
    with pytest.raises(InputError, match="'spline', 'linear', 'previous' or 'band-limited'"):
        FitOptions(input_interpolation=wrong)
