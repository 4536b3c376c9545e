"""How sure a model's predictions are, and what it leaves over of a record."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from reduced_models.models.model import ReducedModel

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
    model: ReducedModel,
    times: np.ndarray,
    inputs: Mapping[str, np.ndarray] | None,
    confidence: float | None,
) -> Band:
    """The motion from the fitted start on, with the band that the covariance leaves.

    Raises
    ------
    InputError
        If the model has no covariance, as one from a file of a former release.
    """
    from scipy.stats import norm

    if not model.covariance_names:
        raise InputError("the model has no covariance, as models of former releases; fit it again")
    level = model.confidence if confidence is None else confidence
    if not 0.0 < level < 1.0:
        raise InputError(f"confidence = {level}; give a fraction between 0 and 1")
    here = model.simulate(times, inputs=inputs).height
    spread = np.sqrt(np.maximum(np.diag(model.covariance), 0.0))
    slopes = np.zeros((len(here), len(spread)))
    for k, name in enumerate(model.covariance_names):
        value = _value(model, name)
        step = max(_STEP * spread[k], _LEAST * abs(value))
        if spread[k] > 0.0 and math.isfinite(step):
            moved = [
                _moved(model, name, value + sign * step).simulate(times, inputs=inputs).height
                for sign in (1.0, -1.0)
            ]
            slopes[:, k] = (moved[0] - moved[1]) / (2.0 * step)
    variance = np.einsum("np,pq,nq->n", slopes, model.covariance, slopes)
    width = float(norm.ppf(0.5 + 0.5 * level)) * np.sqrt(np.maximum(variance, 0.0))
    noise = max(model.quality.noise, model.quality.residual)
    return Band(np.asarray(times, dtype=float), here, here - width, here + width, noise, level)


def _value(model: ReducedModel, name: str) -> float:
    known = {
        **model.parameters, "shift": model.map.shift, "scale": model.map.scale,
        "height": model.initial[0], "velocity": model.initial[1],
    }  # fmt: skip
    return float(known[name] if name in known else model.hidden.get(name, 0.0))


def _moved(model: ReducedModel, name: str, value: float) -> ReducedModel:
    """A model with another value of one of what was fitted."""
    if name in model.parameters:
        return dataclasses.replace(model, parameters={**model.parameters, name: value})
    if name == "shift":
        return dataclasses.replace(model, map=dataclasses.replace(model.map, shift=value))
    if name == "scale":
        return dataclasses.replace(model, map=dataclasses.replace(model.map, scale=value))
    if name in ("height", "velocity"):
        place = ("height", "velocity").index(name)
        other = tuple(value if k == place else each for k, each in enumerate(model.initial))
        return dataclasses.replace(model, initial=(other[0], other[1]))
    return dataclasses.replace(model, hidden={**model.hidden, name: value})


def plot(model: ReducedModel, record: PistonRecord) -> Figure:
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
