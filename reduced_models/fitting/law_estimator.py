"""A law as a scikit-learn estimator, for searches and pipelines of scikit-learn."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Self

import numpy as np
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from granular.records.record import PistonRecord
from granular.shared.errors import InputError
from reduced_models.fitting.fit import fit
from reduced_models.fitting.parameter import Parameters
from reduced_models.fitting.problem import STARTS, TEST_FRACTION
from reduced_models.fitting.residuals import LossName
from reduced_models.laws.law import Law
from reduced_models.models.model import ReducedModel

if TYPE_CHECKING:
    from sklearn.utils import Tags


class LawEstimator(RegressorMixin, BaseEstimator):  # type: ignore[misc]  # scikit-learn has no types
    """A law to be fitted to heights at given times, as a scikit-learn regressor.

    Arguments are stored unchanged and checked by `fit`; see `reduced_models.fit` for all of them.

    Parameters
    ----------
    law : str or Law
        A law of the package by its name, an equation, or a Law.
    starts : int
        Number of random starts, from 1 to 10000.
    test_fraction : float
        Fraction, from 0 to 0.9, of the motion's whole cycles that are held out to judge a first model.
        Use 0 within a search of scikit-learn, which holds out data itself.
    parameters : mapping of str to Parameter, float or str, optional
        Start values, fixed values and bounds of parameters by name.
    loss : "linear", "soft_l1" or "huber"
        Cost of the residuals: their squares (``"linear"``), or less than the square for residuals far
        above the noise.
    inputs : tuple of str
        Inputs of the law, such as a force, in the columns of X after the time.

    Attributes
    ----------
    model_ : ReducedModel
        Fitted model; present only after `fit`.
    """

    model_: ReducedModel

    def __init__(
        self,
        law: str | Law = "linear",
        starts: int = STARTS,
        test_fraction: float = TEST_FRACTION,
        parameters: Parameters | None = None,
        loss: LossName = "linear",
        inputs: tuple[str, ...] = (),
    ) -> None:
        self.law = law
        self.starts = starts
        self.test_fraction = test_fraction
        self.parameters = parameters
        self.loss = loss
        self.inputs = inputs

    def fit(self, X: Any, y: Any) -> Self:
        """Fit the law to heights at given times.

        Parameters
        ----------
        X : array (n, 1 + inputs)
            Times [s], in any order, and the inputs at these times.
        y : array (n,)
            Heights [m].

        Returns
        -------
        LawEstimator
            This estimator, with ``model_``.

        Raises
        ------
        ValueError
            If scikit-learn refuses X or y: wrong shape, different lengths, or a value
            that is not a finite real number.
        InputError
            If X has other columns than the time and the inputs, an argument of the estimator is out of its
            range, or the law cannot be fitted.
        RecordError
            If times and heights do not form a record (two heights at one time, fewer than 20 samples
            to fit, no motion), or the law has an input that is not among ``inputs``.

        Warns
        -----
        UserWarning
            For each note of the model, as `reduced_models.fit` does.
        """
        table, heights = validate_data(self, X, y, dtype=np.float64, y_numeric=True)
        if table.shape[1] != 1 + len(self.inputs):
            names = " and ".join(("the time", *self.inputs))
            raise InputError(f"X has {table.shape[1]} columns; give {1 + len(self.inputs)}: {names}")
        order = np.argsort(table[:, 0], kind="stable")
        self._seen = table[order]
        columns = dict(zip(("time", *self.inputs), self._seen.T, strict=True))
        record = PistonRecord.from_columns({**columns, "height": heights[order]})
        options = self.get_params(deep=False)
        del options["inputs"]
        self.model_ = fit(record, **options)
        return self

    def predict(self, X: Any) -> np.ndarray:
        """Predict the heights of the fitted motion, at times not before the start of the fitted record.

        Between the end of the fitted record and the first given time the inputs are interpolated.

        Parameters
        ----------
        X : array (n, 1 + inputs)
            Times [s], in any order, and the inputs at these times. A time may occur twice.

        Returns
        -------
        float64 (n,)
            Heights [m] of the motion from the fitted initial state, in the order of X.

        Raises
        ------
        NotFittedError
            Before a fit.
        ValueError
            If scikit-learn refuses X, as in `fit`.
        InputError
            For times before the record, or if the motion diverges or is too stiff or too long to compute.
        """
        check_is_fitted(self, "model_")
        table = validate_data(self, X, dtype=np.float64, reset=False)
        wanted, start = table[:, 0], float(self._seen[0, 0])
        if wanted.min() < start:
            raise InputError(
                f"a prediction cannot begin before the fitted record, which begins at {start:g} s; give "
                "later times, as the folds of TimeSeriesSplit do"
            )
        # An input acts from the record's start on, so its earlier values affect the motion.
        rows = np.vstack([self._seen if self.inputs else self._seen[:1], table])
        grid, first = np.unique(rows[:, 0], return_index=True)
        if len(grid) == 1:
            return np.full(len(wanted), self.model_.initial[0])
        inputs = dict(zip(self.inputs, rows[first, 1:].T, strict=True))
        return self.model_.simulate(grid, inputs=inputs).height[np.searchsorted(grid, wanted)]

    def __sklearn_tags__(self) -> Tags:
        """Tell scikit-learn that the regressor predicts poorly on tables that are not a motion in time."""
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = True
        return tags
