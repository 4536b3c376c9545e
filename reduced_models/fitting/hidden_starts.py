"""Start values of a law with hidden states that is known by its equation alone.

Hidden states are not in a record, but what drives them is: for trial parameters they are carried
along the smoothed motion of the first swings, and the accelerations that follow are compared with
those of the record. The best of many random draws are then fitted to the accelerations.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from granular.run.record import PistonRecord
from reduced_models.fitting.smoothing import Smoothed, smoothed
from reduced_models.laws.equation import compiled_field
from reduced_models.laws.law import Law
from reduced_models.least_squares.levenberg_marquardt import Normal, Prior, search
from reduced_models.records.first_guesses import FirstGuesses
from reduced_models.records.inputs import column, drive_at

_SWINGS, _NODES_A_SWING = 6.0, 32
_ROUNDS, _DRAWS, _KEPT = 8, 4096, 48
_TRIALS = 40
_STEP = 1e-6  # of the logarithms, for slopes
_FAR = 1e6
_GOOD = 4.0  # times the least mean square: a start that is kept

Draw = Callable[[int], np.ndarray]
"""Random parameters (count, p)."""


def hidden_starts(law: Law, guess: FirstGuesses, record: PistonRecord, draw: Draw) -> np.ndarray:
    """Parameters (k, p), the best first, from random draws."""
    end = min(float(record.time[-1]), _SWINGS * guess.period)
    nodes = np.linspace(0.0, end, max(48, round(_NODES_A_SWING * end / guess.period)))
    motion = smoothed(record, guess.period, nodes)
    drive = drive_at(record.time, [column(record, name) for name in law.inputs], motion.time)
    carried = along(law, motion, drive)
    scale = max(float(np.abs(motion.acceleration).max()), 1e-300)
    half = motion.acceleration[:, None]

    def misfits(values: np.ndarray) -> np.ndarray:
        """Differences (n, m) for parameters (m, p), in units of the greatest acceleration."""
        found = (carried(values.T).acceleration - half) / scale
        return np.nan_to_num(np.clip(found, -_FAR, _FAR), nan=_FAR)

    best = np.empty((0, len(law.parameters)))
    for _ in range(_ROUNDS):
        drawn = np.vstack([best, draw(_DRAWS)])
        order = np.argsort((misfits(drawn) ** 2).sum(axis=0))
        best = drawn[order[:_KEPT]]
    found, cost = search(
        _normal(best, misfits), np.zeros_like(best),
        Prior(np.full(best.shape[1], 0.01), float(len(nodes))), 1e-4, trials=_TRIALS,
    )  # fmt: skip
    values = best * np.exp(np.clip(found, -50.0, 50.0))
    order = np.argsort(cost)
    good = order[cost[order] <= _GOOD * cost[order[0]] + 1e-12]
    return np.asarray(values[good])


class Carried(NamedTuple):
    """What a law says along a motion: accelerations (n, m), and hidden states (h, m) at its end."""

    acceleration: np.ndarray
    hidden: np.ndarray


def along(law: Law, motion: Smoothed, drive: np.ndarray) -> Callable[[np.ndarray], Carried]:
    """A function of parameters (p, m); hidden states go from zero along the motion.

    They do so by Heun's method; ``drive`` (n, inputs) holds the inputs.
    """
    field = compiled_field(law.equation, law.inputs, "numpy")
    z, v, time = motion.height, motion.velocity, motion.time

    def carried(values: np.ndarray) -> Carried:
        count = values.shape[1]
        hidden = np.zeros((len(law.hidden), count))
        found = np.empty((len(time), count))

        def rates(k: int, states: np.ndarray) -> Any:
            rows = field(z[k], v[k], *states, *drive[k], *values)
            return [np.broadcast_to(row, count) for row in rows]

        with np.errstate(all="ignore"):
            for k in range(len(time)):
                found[k], *here = rates(k, hidden)
                if k + 1 < len(time):
                    step = time[k + 1] - time[k]
                    slope = np.array(here)
                    ahead = np.clip(hidden + step * slope, -_FAR, _FAR)
                    late = np.array(rates(k + 1, ahead)[1:])
                    moved = hidden + 0.5 * step * (slope + late)
                    hidden = np.nan_to_num(np.clip(moved, -_FAR, _FAR))
        return Carried(found, hidden)

    return carried


def _normal(units: np.ndarray, misfits: Callable[[np.ndarray], np.ndarray]) -> Normal:
    """The normal equations of logarithms (m, p) of factors of the units, by differences."""

    def normal(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        count, size = theta.shape
        moved = np.repeat(theta[None], size + 1, axis=0)
        moved[np.arange(1, size + 1), :, np.arange(size)] += _STEP
        values = units * np.exp(np.clip(moved, -50.0, 50.0))
        left = misfits(values.reshape(-1, size)).reshape(-1, size + 1, count)
        slopes = (left[:, 1:] - left[:, :1]) / _STEP
        here = left[:, 0]
        return (
            (here**2).sum(axis=0),
            np.einsum("nps,ns->sp", slopes, here),
            np.einsum("nps,nqs->spq", slopes, slopes),
        )

    return normal
