"""How sure a model's predictions are, and what it leaves over of a record."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import InputError
from reduced_models.models.fitted_law import FittedLaw

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STEP = 1e-3  # of a standard deviation, for slopes: the solver's error is far below it
_LEAST = 1e-9  # of a value: a step is no shorter


class Band(NamedTuple):
    """A prediction with its confidence band.

    Attributes
    ----------
    time, height, low, high : float64 (n,)
        [s], [m]; the band of the motion itself.
    noise : float
        Standard deviation that a measured sample has beside it [m].
    confidence : float
    """

    time: np.ndarray
    height: np.ndarray
    low: np.ndarray
    high: np.ndarray
    noise: float
    confidence: float


def correlation(covariance: np.ndarray) -> np.ndarray:
    """Correlations (p, p); zero beside entries that do not vary."""
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    inverse = np.divide(1.0, spread, out=np.zeros_like(spread), where=spread > 0.0)
    return np.asarray(covariance * np.outer(inverse, inverse))


def prediction(
    model: FittedLaw,
    covariance: np.ndarray,
    names: Sequence[str],
    moved: Callable[[str, float], FittedLaw],
    times: np.ndarray,
    inputs: Mapping[str, np.ndarray] | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Heights (n,) from the fitted start on, and the standard deviations that a covariance leaves.

    ``moved`` gives the model with another value of one of the names.

    Raises
    ------
    InputError
        If the model has no covariance, as one from a file of a former release.
    """
    if not names:
        raise InputError("the model has no covariance, as models of former releases; fit it again")
    here = model.simulate(times, inputs=inputs).height
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    slopes = np.zeros((len(here), len(spread)))
    for k, name in enumerate(names):
        value = value_of(model, name)
        step = max(_STEP * spread[k], _LEAST * abs(value))
        if spread[k] > 0.0 and math.isfinite(step):
            sides = [
                moved(name, value + sign * step).simulate(times, inputs=inputs).height
                for sign in (1.0, -1.0)
            ]
            slopes[:, k] = (sides[0] - sides[1]) / (2.0 * step)
    variance = np.einsum("np,pq,nq->n", slopes, covariance, slopes)
    return here, np.sqrt(np.maximum(variance, 0.0))


def value_of(model: FittedLaw, name: str) -> float:
    """The value of a parameter, of the map, or of the start, by its name."""
    known = {
        **model.parameters, "shift": model.map.shift, "scale": model.map.scale,
        "height": model.initial[0], "velocity": model.initial[1],
    }  # fmt: skip
    return float(known[name] if name in known else model.hidden.get(name, 0.0))


def plot(model: FittedLaw, record: PistonRecord) -> Figure:
    """A record with the model's motion over it, and what that leaves over below."""
    from granular.shared.plotting import COLOURS, GREY, figure

    motion = model.follow(record)
    with figure(height=4.2) as (drawing, axes):
        axes.plot(record.time, record.height, ".", markersize=2.0, color=GREY, label="record")
        axes.plot(motion.time, motion.height, color=COLOURS[0], label=model.law.name[:40])
        axes.set_ylabel("height [m]")
        axes.set_xlabel("time [s]")
        axes.legend(loc="upper right")
        inset: Any = axes.inset_axes((0.0, -0.55, 1.0, 0.32), sharex=axes)
        inset.plot(record.time, record.height - motion.height, color=COLOURS[1], linewidth=0.6)
        inset.set_ylabel("left over [m]")
        return drawing
