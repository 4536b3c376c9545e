"""Comparison of laws on held-out data, and its verdict."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import IdentifyOptions, compare, fit, identify, roll_out
from reduced_models.fitting import levenberg_marquardt
from reduced_models.identification import comparison
from reduced_models.identification.comparison_table import ComparisonRow
from reduced_models.laws import LAWS
from reduced_models.laws.law import Law
from reduced_models.laws.solution import solve_law
from tests.reduced_models.made import damped_cosine, noisy


def test_comparison_ranks_the_true_law_first(made: Any) -> None:
    table = compare(
        made("duffing"),
        ["linear", "polynomial-spring", "duffing"],
        test_records=[made("duffing", seed=9, start=1.5)],
        starts=2,
    )
    best, _, last = table.rows
    assert [row.name for row in table.rows] == ["duffing", "polynomial-spring", "linear"]
    assert (best.error, best.records[0].relative, table.noise) == pytest.approx(3 * (0.01,), rel=0.1)
    assert last.error > 0.2
    for words in ("the data cannot distinguish polynomial-spring from ", "linear is", "times worse"):
        assert words in table.verdict
    (linear,) = (line for line in str(table).splitlines() if "a linear model " in line)
    assert linear.startswith("  a linear model suffices for an error of ")
    assert "(record 1: " in linear
    assert len(table.cells()[0]) == len(table.header)
    ax = Figure().subplots()
    assert table.plot(ax) is ax
    rows = table.to_dataframe()
    assert list(rows["law"]) == ["duffing", "polynomial-spring", "linear"]
    assert rows["record 1"][0] == best.records[0].relative
    assert repr(table).startswith("Comparison of 3 laws, the best first: duffing, ")
    assert table._repr_html_().count("<tr>") == 4
    assert table._repr_latex_().count(r"\\") == 4
    assert table.to_plain()["best"] == "duffing"
    assert table.best.parameters["beta"] == pytest.approx(0.8, rel=0.01)


def test_laws_that_cannot_be_fitted_are_listed_last_in_a_comparison(made: Any) -> None:
    law = Law("pushed", "z'' + k*z = push", positive=("k",), inputs=("push",))
    table = compare(made("linear"), [law, "linear"], starts=2)
    assert table.rows[0].name == "linear"
    assert "has the input 'push'" in table.rows[1].failure
    assert table.verdict.endswith("pushed could not be fitted.")
    assert "push" in str(table)
    assert table._repr_html_().count("<td") == 2 * len(table.header)
    assert table.to_dataframe()["failure"][1] == table.rows[1].failure
    with pytest.raises(InputError, match="no law could be fitted"):
        compare(made("linear"), [law])
    with pytest.raises(InputError, match="give one or more laws"):
        compare(made("linear"), [])


def test_a_diverging_simulation_has_an_infinite_error(made: Any) -> None:
    """With a softening spring, the simulated piston moves away without limit from a large amplitude."""
    model = fit(made("duffing"), "duffing", starts=2)
    softening = dataclasses.replace(model, parameters={**model.parameters, "beta": -0.8})
    found = roll_out(softening, made("duffing"))
    assert math.isinf(found.error)
    assert len(found.motion) < 2000
    assert ComparisonRow("softening", (softening,), records=(found,)).divergence_count == 1


def test_a_given_model_is_compared_by_fitting_its_law_again(made: Any) -> None:
    model = fit(made("linear"), "z'' + 2*d*z' + k*z = g", starts=2)
    table = compare(made("linear", seed=1), [model, "linear"], starts=2)
    assert {row.name for row in table.rows} == {model.law.name, "linear"}
    assert all(row.error == pytest.approx(0.01, rel=0.1) for row in table.rows)


def test_a_prediction_of_the_complete_record_uses_only_its_first_period(made: Any) -> None:
    """Changing later samples does not change the prediction."""
    model = fit(made("duffing"), "duffing", starts=2)
    record = made("duffing", seed=3)
    late = record.time > 12.0
    moved = PistonRecord(record.time, record.height + 1e-3 * late)
    first, second = roll_out(model, record), roll_out(model, moved)
    np.testing.assert_allclose(first.motion.height, second.motion.height, atol=2e-5)
    assert second.error > first.error
    assert first.relative == pytest.approx(0.01, rel=0.15)
    assert first.at_rest > 0.9
    assert math.isfinite(first.error)


def test_the_simplest_law_within_one_standard_error_has_the_first_rank(made: Any) -> None:
    """A law of 8 parameters has a 1.12 times smaller error than one of 3 parameters.

    The law of 8 parameters is ranked first only if the standard error of its error is small.
    """
    models = (fit(made("duffing"), "linear", starts=2),)  # its error is far above the noise
    small = ComparisonRow("small", models, 3, error=0.56, standard_error=0.05)
    for sure, first, words in (
        (
            0.08,
            "small",
            "large (50 %) is not better by more than one standard error despite its 5 more param",
        ),
        (0.02, "large", "small is 1.12 times worse"),
    ):
        large = ComparisonRow("large", models, 8, error=0.5, standard_error=sure)
        table = comparison._rank_comparison_rows([large, small], [large, small])
        assert table.rows[0].name == first
        assert words in table.verdict


def test_laws_beyond_the_time_budget_are_skipped_and_listed(
    made: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Laws fitted within the budget are kept. If no law is fitted, the error names the option --budget."""
    spent, make_row = [0.0], comparison._fit_law_and_make_row

    def make_slowly(*arguments: Any) -> ComparisonRow:
        row = make_row(*arguments)
        spent[0] += 200.0
        return row

    monkeypatch.setattr(levenberg_marquardt.time, "process_time", lambda: spent[0])
    monkeypatch.setattr(comparison, "_fit_law_and_make_row", make_slowly)
    laws = ["linear", "coulomb", "duffing"]
    with pytest.warns(UserWarning, match=r"fit of duffing failed: not finished .*--budget 1500\)"):
        found = identify(made("linear"), laws=laws, starts=2, progress=False)
    assert {model.law.name for model in found.models} == {"linear", "coulomb"}
    assert found.comparison.rows[-1].failure
    monkeypatch.setattr(levenberg_marquardt.time, "process_time", iter(range(0, 10**6, 7)).__next__)
    with pytest.raises(InputError, match=r"no law could be fitted; the fit of linear failed: .*--budget 25"):
        identify(made("linear"), laws=laws, options=IdentifyOptions(budget=5.0), progress=False)


def test_the_command_compare_respects_the_time_budget(
    made: Any, command: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    made("linear").to_csv(tmp_path / "lab.csv")
    words = ("compare", str(tmp_path / "lab.csv"), "--law", "all", "--starts", "1")
    monkeypatch.setattr(levenberg_marquardt.time, "process_time", iter(range(0, 10**6, 7)).__next__)
    done = command("reduced_models", *words, "--budget", "5")
    assert done.returncode == 2
    assert "no law could be fitted; " in done.stderr
    assert "not finished within the budget of 5 s of processor time; to increase it: " in done.stderr
    done = command("reduced_models", *words, "--budget", "0")
    assert done.stderr == "error: budget = 0.0 s; give a time above 0\n"


def decaying_early(name: str, seed: int) -> PistonRecord:
    """Return a decay that falls below 1 % noise after a third of the record."""
    random = np.random.default_rng([seed, len(name)])
    time, third = np.linspace(0.0, 60.0, 2000), 20.0
    omega, rest = random.uniform(3.0, 6.0), random.uniform(-2.0, 2.0)
    viscous, spring = math.log(100.0) / third, {"omega": omega, "g0": omega**2 * rest}
    values = {
        "linear": {"lam": viscous, **spring},
        "duffing": {"lam": viscous, "k": omega**2, "rest": rest, "beta": 0.4 * omega**2},
        "coulomb": {"friction": 0.5 * math.pi * omega / third, **spring},
    }[name]
    law = LAWS[name]
    motion = solve_law(law, time, rest + 1.0, 0.0, [values[key] for key in law.parameters], 1.0)
    assert np.abs(motion.z[time > third] - rest).max() < 0.02
    return PistonRecord(time, motion.z + random.normal(0.0, 0.01, len(time)))


def test_comparison_ranks_the_true_law_first_for_a_record_that_is_mostly_noise() -> None:
    # As many samples as other records, for which code is already compiled.
    table = compare(decaying_early("coulomb", 0), ["linear", "coulomb"], starts=2)
    assert table.rows[0].name == "coulomb"
    (model,) = table.rows[0].models
    assert len(model.quality.test_swings) > 2
    assert model.quality.test_swings[-1][1] < 25.0
    assert "motionless piston" in table.verdict


@pytest.mark.long
def test_comparison_of_nested_laws_ranks_the_true_law_first_in_most_trials(made: Any) -> None:
    """The noise is 1 %, and the motion may fall below it early."""
    laws = ["polynomial-spring", "duffing", "coulomb", "linear"]
    records = [(name, made(name, seed)) for name in laws[1:] for seed in range(5)]
    records += [(name, decaying_early(name, seed)) for name in laws[1:] for seed in range(5)]
    assert sum(compare(record, laws).rows[0].name == name for name, record in records) >= 27


@pytest.mark.parametrize("at_noise", [True, False])
def test_the_simplest_packaged_law_has_the_first_rank_among_equivalent_laws(at_noise: bool) -> None:
    """The rank depends neither on the order of the arguments nor on differences of BIC up to 2."""
    rows = [
        ComparisonRow("van-der-pol-like", parameters=3, error=0.02, bic=-101.6),
        ComparisonRow("z'' + a*z = 0", parameters=1, error=0.02, bic=-101.0),
        ComparisonRow("duffing", parameters=4, error=0.0199, bic=-102.0),
        ComparisonRow("linear", parameters=3, error=0.0201, bic=-100.0),
        ComparisonRow("coulomb", parameters=3, error=0.0204, bic=-80.0),
    ]
    for order in (rows, rows[::-1]):
        names = [row.name for row in comparison.sort_simplest_known_law_first(order, at_noise=at_noise)]
        assert names[0] == "linear"
        assert (names[-1] == "coulomb") == at_noise


@pytest.mark.parametrize("sign", [pytest.param(1.0, marks=pytest.mark.long), -1.0])
def test_comparison_for_a_record_with_reversed_sign_has_the_same_best_law(sign: float) -> None:
    time, omega = np.linspace(0.0, 4.0, 800), 6.0 * math.pi
    height = sign * (0.06 + damped_cosine(time, 1e-3, 0.03 * omega, omega))
    for seed in range(3):
        table = compare(noisy(time, height, 1e-5, seed), ["van-der-pol-like", "duffing", "linear"], starts=2)
        assert table.rows[0].name == "linear"
