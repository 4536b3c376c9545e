"""A law as an estimator in the manner of scikit-learn: fit, predict, score.

It works in that library's searches and pipelines, and does not need it: only a search asks for
`LawEstimator.__sklearn_tags__`, and has the library then.
"""

from __future__ import annotations

import sys
import warnings
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from granular.run.piston_record import PistonRecord
from granular.schema.field_kinds import unknown_word_message
from granular.shared.errors import InputError
from reduced_models.fitting.fit import fit
from reduced_models.fitting.options import STARTS, TEST_FRACTION
from reduced_models.fitting.parameter import Parameters
from reduced_models.laws.law import Law
from reduced_models.least_squares.residuals import LossName
from reduced_models.models.model import ReducedModel

if TYPE_CHECKING:
    from sklearn.utils import Tags


class LawEstimator:
    """A law to be fitted to heights at given times, as an estimator in the manner of scikit-learn.

    Arguments are kept as they are, and checked by `fit`; see `reduced_models.fit` for all of them.

    Parameters
    ----------
    law : str or Law
        A law of the package by its name, an equation, or a Law.
    starts : int
        Number of random starts, from 1 to 10000.
    test_fraction : float
        Fraction of the motion's whole swings, from 0 to 0.9, on which a first model is judged; 0 in
        a search, which holds out by itself.
    parameters : mapping of str to Parameter, float or str, optional
        Values and limits of parameters by name.
    loss : "linear", "soft_l1" or "huber"
        What residuals cost: their squares, or less where they are far beyond the noise.
    inputs : tuple of str
        Inputs of the law, such as a force, that the columns of X behind the time hold.

    Attributes
    ----------
    model_ : ReducedModel
        Fitted model; there after `fit` alone.
    n_features_in_ : int
        Number of columns of X, one for the time and one for each input; there after `fit` alone.
    """

    model_: ReducedModel
    n_features_in_: int

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

    def __repr__(self) -> str:
        given = ", ".join(f"{name}={value!r}" for name, value in self.get_params().items())
        return f"LawEstimator({given})"

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the arguments of the estimator, as they were given or set last.

        Parameters
        ----------
        deep : bool
            As scikit-learn asks for; it changes nothing here.

        Returns
        -------
        dict of str to any
            ``law``, ``starts``, ``test_fraction``, ``parameters``, ``loss``, ``inputs``.
        """
        names = ("law", "starts", "test_fraction", "parameters", "loss", "inputs")
        return {name: getattr(self, name) for name in names}

    def set_params(self, **parameters: Any) -> Self:
        """Change arguments that the estimator was made with; the next `fit` checks and uses them.

        Parameters
        ----------
        **parameters
            New values of the arguments by name, as in `get_params`.

        Returns
        -------
        LawEstimator
            This estimator.

        Raises
        ------
        InputError
            If there is no argument of a name; those before it are changed.
        """
        for name, value in parameters.items():
            if name not in self.get_params():
                raise InputError(unknown_word_message(name, tuple(self.get_params()), "parameter"))
            setattr(self, name, value)
        return self

    def fit(self, X: Any, y: Any) -> Self:
        """Fit the law to heights at given times.

        Parameters
        ----------
        X : array (n,), (n, 1) or (n, 1 + inputs)
            Times [s], in any order, and the inputs at these times; (n,) without inputs alone.
        y : array (n,)
            Heights [m]; a column (n, 1) is taken too.

        Returns
        -------
        LawEstimator
            This estimator, with ``model_``.

        Raises
        ------
        InputError
            If X or y has another shape or holds a value that is no finite real number, they are not
            as many, an argument of the estimator is out of its range, or the law cannot be fitted.
        RecordError
            If times and heights make no record (two heights at one time, fewer than 20 samples to
            fit, no motion), or the law has an input that is not among ``inputs``.

        Warns
        -----
        UserWarning
            For each note of the model, as `reduced_models.fit` does, and for heights in a column.
        """
        table, heights = self._times_and_inputs(X), _height_vector(y)
        if len(table) != len(heights):
            raise InputError(f"{len(table)} times for {len(heights)} heights; give one for each")
        order = np.argsort(table[:, 0], kind="stable")
        self._seen = table[order]
        extra = dict(zip(self.inputs, self._seen[:, 1:].T, strict=True))
        columns = {"time": self._seen[:, 0], "height": heights[order], **extra}
        options = {name: value for name, value in self.get_params().items() if name != "inputs"}
        self.model_ = fit(PistonRecord.from_columns(columns), **options)
        self.n_features_in_ = 1 + len(self.inputs)
        return self

    def predict(self, X: Any) -> np.ndarray:
        """Predict heights at times from the start of the fitted record on.

        Between the fitted record and these times the inputs are interpolated.

        Parameters
        ----------
        X : array (n,), (n, 1) or (n, 1 + inputs)
            Times [s], in any order, and the inputs at these times; (n,) without inputs alone. A
            time may be there twice.

        Returns
        -------
        float64 (n,)
            Heights [m] in the order of X, of the motion from the fitted initial state.

        Raises
        ------
        InputError
            Before a fit (for scikit-learn it is a NotFittedError too), for X of another shape,
            without rows or with a value that is no finite real number, for times before the record,
            or where the motion diverges or is too stiff or too long to follow.
        """
        if not hasattr(self, "model_"):
            raise _not_fitted_error("the estimator has seen no data; call fit first")
        table = self._times_and_inputs(X)
        wanted, start = table[:, 0], float(self._seen[0, 0])
        if not len(wanted):
            raise InputError("there are no times; give at least one")
        if wanted.min() < start:
            raise InputError(
                f"predict starts where the fitted record does, at {start:g} s; give times "
                "from there on: TimeSeriesSplit makes such folds"
            )
        # An input acts from the record's start on: what it was then belongs to the motion.
        rows = np.vstack([self._seen if self.inputs else self._seen[:1], table])
        grid, first = np.unique(rows[:, 0], return_index=True)
        if len(grid) == 1:
            return np.full(len(wanted), self.model_.initial[0])
        inputs = dict(zip(self.inputs, rows[first, 1:].T, strict=True))
        return self.model_.simulate(grid, inputs=inputs).height[np.searchsorted(grid, wanted)]

    def _times_and_inputs(self, given: Any) -> np.ndarray:
        """Return times and inputs (n, 1 + inputs) of a table, or of a vector of times."""
        array, size = _real_array(given, "the times X"), 1 + len(self.inputs)
        names = " and ".join(("the time", *self.inputs))
        if array.ndim == 2 and array.shape[1] == 0:
            raise InputError(f"0 feature(s) (shape={array.shape}) while a minimum of 1 is required: {names}")
        if array.ndim == 1 and size == 1:
            array = array[:, None]
        if array.ndim != 2:
            raise InputError(f"X has the shape {array.shape}; give (n,) times, or (n, {size}): {names}")
        if array.shape[1] != size:
            raise InputError(
                f"X has {array.shape[1]} features, but LawEstimator is expecting {size} features as "
                f"input: {names}"
            )
        return array

    def score(self, X: Any, y: Any) -> float:
        """Coefficient of determination R^2 of the prediction; 0 where the heights are all one.

        Parameters
        ----------
        X : array (n,), (n, 1) or (n, 1 + inputs)
            Times [s], in any order, and the inputs at these times; (n,) without inputs alone.
        y : array (n,)
            Heights [m]; a column (n, 1) is taken too.

        Returns
        -------
        float
            R^2, one less the sum of squared errors over that of the heights about their mean;
            without unit, at most 1, below 0 for a prediction worse than the mean.

        Raises
        ------
        InputError
            As `predict`, and for heights of another shape, that are no finite numbers, or not as
            many as the times.

        Warns
        -----
        UserWarning
            For heights in a column.
        """
        wanted, predicted = _height_vector(y), self.predict(X)
        if len(wanted) != len(predicted):
            raise InputError(f"{len(predicted)} times for {len(wanted)} heights; give one for each")
        left = ((wanted - predicted) ** 2).sum()
        spread = ((wanted - wanted.mean()) ** 2).sum()
        return float(1.0 - left / spread) if spread > 0.0 else 0.0

    def __sklearn_tags__(self) -> Tags:
        """Tags of an estimator for scikit-learn: a regressor of one column, the time."""
        from sklearn.utils import InputTags, RegressorTags, Tags, TargetTags

        return Tags(
            estimator_type="regressor",
            target_tags=TargetTags(required=True),
            regressor_tags=RegressorTags(poor_score=True),  # on tables that are no motion in time
            input_tags=InputTags(one_d_array=True),
        )


def _height_vector(given: Any) -> np.ndarray:
    """Heights (n,) of a vector, or with a warning of a column."""
    if given is None:
        raise InputError(
            "LawEstimator requires y to be passed, but the target y is None; give the heights [m]"
        )
    array = _real_array(given, "the heights y")
    if array.ndim == 2 and array.shape[1] == 1:
        words = "A column-vector y was passed when a 1d array was expected; it is flattened"
        warnings.warn(words, _sklearn_exception("DataConversionWarning", UserWarning), stacklevel=3)
        return array[:, 0]
    if array.ndim != 1:
        raise InputError(f"the heights y have the shape {array.shape}; give (n,)")
    return array


def _real_array(given: Any, name: str) -> np.ndarray:
    """Array of real numbers."""
    if hasattr(given, "tocsr"):
        raise InputError(f"{name} are a sparse matrix; give a dense array, as by .toarray()")
    array = np.asarray(given)
    if np.iscomplexobj(array):
        raise InputError(f"Complex data not supported: {name} are complex; give real numbers")
    try:
        array = array.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} hold something that is no number ({error})") from None
    if not np.isfinite(array).all():
        raise InputError(f"{name} hold NaN or inf; give finite numbers")
    return array


def _not_fitted_error(message: str) -> InputError:
    """Error that scikit-learn, where it is loaded, takes for its NotFittedError too."""
    kind = _sklearn_exception("NotFittedError", InputError)
    return kind(message) if kind is InputError else type("NotFitted", (InputError, kind), {})(message)


def _sklearn_exception(name: str, otherwise: type[Any]) -> type[Any]:
    """Class of scikit-learn's exceptions, where that is loaded."""
    result: type[Any] = getattr(sys.modules.get("sklearn.exceptions"), name, otherwise)
    return result
