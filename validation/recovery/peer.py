"""What fifteen lines of SciPy reach from the same starts: least squares through an ODE solver."""

from __future__ import annotations

import itertools
import warnings
from typing import Any

import numpy as np

from granular.run.record import PistonRecord
from reduced_models.fitting.case import split
from reduced_models.fitting.options import HOLDOUT, STARTS
from reduced_models.fitting.start_vectors import start_vectors, unknowns_of
from reduced_models.laws.equation import compiled_field
from reduced_models.laws.height_map import HeightMap
from reduced_models.laws.law import Law
from reduced_models.records.inputs import TIME, column

_MOST_TRIALS = 40
_FAR = 1e6
_MOST_CALLS = 100  # of the law for each sample, after which a solution is given up
_DIFFERENCE = 1e-5  # of an entry, for slopes: the solver's error is far below what that changes


class _GivenUpError(Exception):
    """A solution takes too long."""


def scipy_fit(record: PistonRecord, law: Law, starts: int) -> list[float]:
    """Root mean squared residuals [m], one for each of the first random starts of the search.

    They are those that ``fit(record, law)`` starts from.
    """
    from scipy.integrate import solve_ivp
    from scipy.interpolate import CubicSpline
    from scipy.optimize import least_squares

    time, height = record.time, record.height
    data = split(record, HOLDOUT, None, None)
    guess = data.guess
    unknowns = unknowns_of(law, HeightMap(), guess, data.training)
    random = np.random.default_rng(0)
    thetas = start_vectors(unknowns, guess, data.training, STARTS, random)[:starts]
    field = compiled_field(law.equation, law.inputs, "numpy")
    drives = [
        (lambda t: t) if name == TIME else CubicSpline(time, column(record, name))
        for name in law.inputs
    ]

    def residuals(theta: np.ndarray) -> np.ndarray:
        values, _, _, z0, v0, hidden = unknowns.physical(theta)

        calls = itertools.count()

        def rates(t: float, state: np.ndarray) -> list[Any]:
            # Some trial parameters let LSODA go on for ever.
            if next(calls) > _MOST_CALLS * len(time):
                raise _GivenUpError
            return [state[1], *field(*state, *(float(drive(t)) for drive in drives), *values)]

        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of solutions that end early
            try:
                found = solve_ivp(
                    rates, (time[0], time[-1]), [z0, v0, *hidden], "LSODA", t_eval=time, rtol=1e-8,
                    atol=1e-10 * guess.amplitude,
                ).y[0]  # fmt: skip
            except _GivenUpError:
                found = np.empty(0)
        full = np.full(len(time), _FAR)
        full[: len(found)] = found - height[: len(found)]
        return np.clip(np.nan_to_num(full, nan=_FAR), -_FAR, _FAR)

    best = []
    for theta in thetas:
        held = np.arange(len(theta)) >= unknowns.free + 2
        found = least_squares(
            lambda x, theta=theta, held=held: residuals(np.array(np.where(held, theta, x))),
            theta, max_nfev=_MOST_TRIALS, x_scale="jac", diff_step=_DIFFERENCE,
        )  # fmt: skip
        best.append(float(np.sqrt((found.fun**2).mean())))
    return best
