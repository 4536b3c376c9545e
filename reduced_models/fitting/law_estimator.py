"""A law as an estimator in the manner of scikit-learn: fit, predict, score.

It follows scikit-learn's conventions (``get_params``, ``set_params``, attributes that end in an
underscore) and does not need that library.
"""

from __future__ import annotations

from typing import Any, Self

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import InputError
from granular.shared.messages import quoted
from reduced_models.fitting.fitting import fit
from reduced_models.fitting.options import STARTS
from reduced_models.laws.law import Law
from reduced_models.models.model import ReducedModel


class LawEstimator:
    """A law to be fitted to heights at given times.

    Parameters
    ----------
    law : str or Law
        As for `fit`.
    starts : int
        Random starts.

    Attributes
    ----------
    model_ : ReducedModel
        After `fit`.
    """

    model_: ReducedModel

    def __init__(self, law: str | Law = "van-der-pol-like", starts: int = STARTS) -> None:
        self.law = law
        self.starts = starts

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """What the estimator was made with."""
        return {"law": self.law, "starts": self.starts}

    def set_params(self, **parameters: Any) -> Self:
        """Change what it was made with.

        Raises
        ------
        InputError
            If there is no such parameter.
        """
        for name, value in parameters.items():
            if name not in self.get_params():
                raise InputError(
                    f"there is no parameter {quoted(name)}; there are 'law' and 'starts'"
                )
            setattr(self, name, value)
        return self

    def fit(self, times: np.ndarray, heights: np.ndarray) -> Self:
        """Fit to heights (n,) [m] at times (n,) or (n, 1) [s]."""
        self.model_ = fit(PistonRecord(_flat(times), heights), self.law, starts=self.starts)
        self._start = float(_flat(times)[0])
        return self

    def predict(self, times: np.ndarray) -> np.ndarray:
        """Heights (n,) [m] at times (n,) or (n, 1) [s] from the start of the fitted record on."""
        if not hasattr(self, "model_"):
            raise InputError("the estimator has seen no data; call fit first")
        wanted = _flat(times)
        if not len(wanted) or wanted.min() < self._start:
            raise InputError(
                f"predict starts where the fitted record does, at {self._start:g} s; give times "
                "from there on"
            )
        grid = np.unique(np.concatenate([[self._start], wanted]))
        if len(grid) < 2:
            return np.full(len(wanted), self.model_.initial[0])
        return self.model_.simulate(grid).height[np.searchsorted(grid, wanted)]

    def score(self, times: np.ndarray, heights: np.ndarray) -> float:
        """Coefficient of determination R^2 of the prediction."""
        wanted = np.asarray(heights, dtype=np.float64)
        left = ((wanted - self.predict(times)) ** 2).sum()
        return float(1.0 - left / ((wanted - wanted.mean()) ** 2).sum())


def _flat(times: np.ndarray) -> np.ndarray:
    return np.asarray(times, dtype=np.float64).reshape(len(times))
