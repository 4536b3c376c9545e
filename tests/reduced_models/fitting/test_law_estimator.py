"""The estimator follows scikit-learn's conventions and works in its searches and pipelines."""

from typing import Any

import numpy as np
import pytest

from granular.records.record import PistonRecord
from reduced_models import LawEstimator, Parameter

SHORT = "fits fewer than the 20 samples that a law is identified from"
IMPOSSIBLE = {
    "check_n_features_in_after_fitting": SHORT,
    "check_positive_only_tag_during_fit": SHORT,
    "check_estimators_nan_inf": SHORT,
    "check_estimators_dtypes": "gives integers as times, and a time twice has two heights",
    "check_n_features_in": "gives tables of several columns; here there is one, the time",
    "check_regressors_no_decision_function": SHORT,
    "check_fit2d_1feature": SHORT,
}


class FirstColumn(LawEstimator):
    """Estimator that uses only the first column of the tables in scikit-learn's checks."""

    def fit(self, X: Any, y: Any) -> "FirstColumn":
        return super().fit(_first(X), y)

    def predict(self, X: Any) -> np.ndarray:
        return super().predict(_first(X))


def _first(table: Any) -> Any:
    if hasattr(table, "tocsr"):
        return table
    table = np.asarray(table)
    return table[:, :1] if table.ndim == 2 and table.shape[1] else table


def _damped(count: int) -> PistonRecord:
    time = np.linspace(0.0, 6.0, count)
    noise = 1e-5 * np.random.default_rng(0).normal(size=count)
    return PistonRecord(time, 0.1 + 0.01 * np.exp(-0.2 * time) * np.cos(4.0 * time) + noise)


FEW = {
    "check_complex_data",
    "check_estimator_cloneable",
    "check_estimator_repr",
    "check_estimator_sparse_matrix",
    "check_estimator_sparse_tag",
    "check_estimator_tags_renamed",
    "check_estimators_empty_data_messages",
    "check_estimators_pickle",
    "check_estimators_unfitted",
    "check_fit_check_is_fitted",
    "check_fit_score_takes_y",
    "check_get_params_invariance",
    "check_no_attributes_set_in_init",
    "check_parameters_default_constructible",
    "check_requires_y_none",
    "check_set_params",
    "check_supervised_y_no_nan",
}
"""Checks whose fits take little time."""


@pytest.mark.filterwarnings("ignore")  # fits of noise have notes
def test_the_estimator_passes_selected_checks_of_scikit_learn() -> None:
    checks = pytest.importorskip("sklearn.utils.estimator_checks")
    made = FirstColumn("linear", starts=1, test_fraction=0.0)
    seen = set()
    for estimator, check in checks.estimator_checks_generator(made):
        name = getattr(check, "func", check).__name__
        if name in FEW:
            check(estimator)
            seen.add(name)
    assert len(seen) > 12  # a release may name some otherwise


@pytest.mark.long  # quick: a selection above
@pytest.mark.filterwarnings("ignore")  # fits of noise have notes
def test_the_estimator_passes_all_checks_of_scikit_learn() -> None:
    checks = pytest.importorskip("sklearn.utils.estimator_checks")
    results = checks.check_estimator(
        FirstColumn("linear", starts=1, test_fraction=0.0), expected_failed_checks=IMPOSSIBLE, on_skip=None
    )
    passed = {one["check_name"] for one in results if one["status"] == "passed"}
    assert len(passed) > 40
    assert not passed & set(IMPOSSIBLE)  # the list has no check that could pass


def test_the_estimator_works_in_a_pipeline() -> None:
    """An earlier step converts times from milliseconds to seconds."""
    pipeline = pytest.importorskip("sklearn.pipeline")
    from sklearn.base import clone
    from sklearn.preprocessing import FunctionTransformer

    record = _damped(240)
    milliseconds = 1e3 * record.time[:, None]
    seconds = FunctionTransformer(lambda times: 1e-3 * times)
    integer = pipeline.make_pipeline(seconds, LawEstimator("linear", starts=1, test_fraction=0.0))
    integer = clone(integer).fit(milliseconds, record.height)
    assert integer.score(milliseconds, record.height) > 0.999
    assert integer[-1].model_.parameters["lam"] == pytest.approx(0.2, rel=0.01)


def test_bounds_and_loss_of_the_estimator_are_passed_to_fit() -> None:
    record = _damped(240)
    height = record.height.copy()
    height[50] += 0.5 * float(np.ptp(height))
    given = {"starts": 1, "test_fraction": 0.0, "loss": "huber"}
    free = LawEstimator("linear", **given).fit(record.time[:, None], height).model_
    assert free.parameters["lam"] == pytest.approx(0.2, rel=0.01)
    held = LawEstimator("linear", parameters={"lam": Parameter(low=0.3, high=0.5)}, **given).fit(
        record.time[:, None], height
    )
    assert held.model_.parameters["lam"] == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("times", "heights", "words"),
    [
        ([[0.0], [1.0]], [0.0], "inconsistent numbers of samples"),
        (np.zeros((2, 3)), [0.0, 1.0], "X has 3 columns; give 1: the time"),
        ([0.0, 1.0], [0.0, 1.0], "Expected 2D array"),
        ([["a"], ["b"]], [0.0, 1.0], "could not convert string"),
        ([[0.0], [np.nan]], [0.0, 1.0], "contains NaN"),
        ([[0.0], [1.0]], None, "the target y is None"),
    ],
)
def test_estimator_refuses_unsuitable_data(times: Any, heights: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        LawEstimator("linear").fit(times, heights)
