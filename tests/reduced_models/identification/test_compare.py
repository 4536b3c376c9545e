"""Laws ranked on held-out data, with an honest verdict."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import compare, fit, roll_out
from reduced_models.identification.comparison_table import Row
from reduced_models.laws.law import Law


def test_the_true_law_is_first(made: Any) -> None:
    table = compare(
        made("duffing"),
        ["linear", "polynomial-spring", "duffing"],
        test_records=[made("duffing", seed=9, start=1.5)],
    )
    assert [row.name for row in table.rows] == ["duffing", "polynomial-spring", "linear"]
    assert table.rows[0].error == pytest.approx(0.01, rel=0.1)
    assert table.rows[0].records[0].relative == pytest.approx(0.01, rel=0.1)
    assert table.rows[2].error > 0.2
    assert table.noise == pytest.approx(0.01, rel=0.1)
    assert "the data cannot tell polynomial-spring from it" in table.verdict
    assert "linear is" in table.verdict
    assert "times worse" in table.verdict
    assert str(table).count("\n") == 5
    assert len(table.cells()[0]) == len(table.header)
    assert table.plot().get_xscale() == "log"
    ax = Figure().subplots()
    assert table.plot(ax) is ax
    rows = table.to_dataframe()
    assert list(rows["law"]) == ["duffing", "polynomial-spring", "linear"]
    assert rows["record 1"][0] == table.rows[0].records[0].relative
    assert repr(table).startswith("Comparison of 3 laws, the best first: duffing, ")
    assert len(repr(table).splitlines()) == 2
    assert table._repr_html_().count("<tr>") == 4
    assert "test error" in table._repr_html_()
    assert table._repr_latex_().count(r"\\") == 4
    assert table.to_plain()["best"] == "duffing"
    assert table.best.parameters["beta"] == pytest.approx(0.8, rel=0.01)


def test_a_law_that_cannot_be_fitted_is_listed(made: Any) -> None:
    """It does not stop the others."""
    law = Law("pushed", "z'' + k*z = push", positive=("k",), inputs=("push",))
    table = compare(made("linear"), [law, "linear"])
    assert table.rows[0].name == "linear"
    assert "has the input 'push'" in table.rows[1].failure
    assert table.verdict.endswith("pushed could not be fitted.")
    assert "push" in str(table)
    assert table._repr_html_().count("<td>") == 2 * len(table.header)
    assert table.to_dataframe()["failure"][1] == table.rows[1].failure
    with pytest.raises(InputError, match="no law could be fitted"):
        compare(made("linear"), [law])
    with pytest.raises(InputError, match="name at least one"):
        compare(made("linear"), [])


def test_a_blow_up_is_an_infinite_error(made: Any) -> None:
    """A spring that softens runs away from a large swing."""
    model = fit(made("duffing"), "duffing")
    softening = dataclasses.replace(model, parameters={**model.parameters, "beta": -0.8})
    found = roll_out(softening, made("duffing"))
    assert math.isinf(found.error)
    assert len(found.motion) < 2000
    assert Row("softening", (softening,), records=(found,)).blow_ups == 1


def test_models_are_compared_by_their_structure(made: Any) -> None:
    model = fit(made("linear"), "z'' + 2*d*z' + k*z = g")
    table = compare(made("linear", seed=1), [model, "linear"])
    assert {row.name for row in table.rows} == {model.law.name, "linear"}
    assert all(row.error == pytest.approx(0.01, rel=0.1) for row in table.rows)


def test_roll_out_predicts_from_the_first_period_alone(made: Any) -> None:
    """What comes later does not move the prediction."""
    model = fit(made("duffing"), "duffing")
    record = made("duffing", seed=3)
    late = record.time > 12.0
    moved = PistonRecord(record.time, record.height + 1e-3 * late)
    first, second = roll_out(model, record), roll_out(model, moved)
    np.testing.assert_allclose(first.motion.height, second.motion.height, atol=2e-5)
    assert second.error > first.error
    assert model.score(record) == pytest.approx(1.0 - 1e-4, abs=3e-5)
    assert first.at_rest > 0.9
    assert math.isfinite(first.error)


WRONG = {
    "duffing": ("linear", "quadratic-drag", "coulomb"),
    "quadratic-drag": ("linear", "coulomb", "duffing"),
    "van-der-pol-like": ("linear", "duffing", "quadratic-drag"),
    "linear": ("quadratic-drag", "coulomb", "van-der-pol"),
}


@pytest.mark.long
def test_a_law_that_cannot_represent_the_data_is_never_first(made: Any) -> None:
    """Twenty trials at 1 % noise."""
    first = []
    for name, others in WRONG.items():
        for seed in range(5):
            table = compare(made(name, seed), [*others, name])
            first.append(table.rows[0].name == name)
    assert sum(first) == 20


@pytest.mark.long
def test_of_two_laws_that_can_the_smaller_one_wins(made: Any) -> None:
    """In at least 18 of 20 trials at 1 % noise."""
    pairs = (("linear", "polynomial-spring"), ("duffing", "polynomial-spring"))
    small = [
        compare(made(name, seed), [larger, name]).rows[0].name == name
        for name, larger in pairs
        for seed in range(10)
    ]
    assert sum(small) >= 18
