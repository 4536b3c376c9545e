"""What fifteen lines of SciPy reach from the same starts: least squares through an ODE solver."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.files import digest
from reduced_models.fitting.fit_data import data_of_record
from reduced_models.fitting.parameter import Unknowns
from reduced_models.fitting.problem import STARTS, TEST_FRACTION
from reduced_models.fitting.start_values import scale_unknowns, start_vectors
from reduced_models.laws.equation import compile_rates
from reduced_models.laws.law import Law
from reduced_models.records.inputs import TIME, input_column

MOST_CALLS = 1500
"""Calls of a law for each sample of a record, after which least squares from a start is stopped.

What converges needs 100 to 1000. Without a limit, laws that have a variable step shrink to nothing
at some trial parameters keep SciPy busy for hours.
"""
_MOST_OF_A_SOLUTION = 100  # calls for each sample, after which a solution is given up
_MOST_TRIALS = 40
_FAR = 1e6
_DIFFERENCE = 1e-5  # of an entry, for slopes: the solver's error is far below what that changes
_DIGITS = 24


class Attempt(NamedTuple):
    """Least squares from one start.

    Attributes
    ----------
    residual : float
        Root mean square of the best trial [m].
    calls : int
        Of the law.
    stopped : bool
        Whether it was stopped at its limit of calls.
    """

    residual: float
    calls: int
    stopped: bool


class _GivenUpError(Exception):
    """A solution takes too long."""


class _StoppedError(Exception):
    """There are no calls left."""


@dataclasses.dataclass
class _Calls:
    """How often a law was called: since the start, and for a solution."""

    most: int
    most_of_a_solution: int
    made: int = 0
    of_a_solution: int = 0

    def count(self) -> None:
        if self.made >= self.most:
            raise _StoppedError
        if self.of_a_solution >= self.most_of_a_solution:
            raise _GivenUpError
        self.made += 1
        self.of_a_solution += 1


class Problem(NamedTuple):
    """A record, the unknowns of a law, and where the search of `fit` starts."""

    record: PistonRecord
    unknowns: Unknowns
    starts: np.ndarray


def problem(record: PistonRecord, law: Law, starts: int) -> Problem:
    """The first of the random starts that ``fit(record, law)`` searches from."""
    data = data_of_record(law, record, TEST_FRACTION)
    data = dataclasses.replace(data, unknowns=scale_unknowns(data))
    result = start_vectors(data, STARTS, np.random.default_rng(0), {})
    return Problem(record, data.unknowns, result[:starts])


def problem_key(given: Problem) -> str:
    """A digest of all that determines what SciPy makes of a problem."""
    import scipy

    record, law = given.record, given.unknowns.law
    content = {
        "record": [record.time.tolist(), record.height.tolist()],
        "starts": given.starts.tolist(),
        "scales": given.unknowns.scales.tolist(),
        "law": [law.equation, law.inputs, law.parameters, law.positive],
        "code": Path(__file__).read_text(encoding="utf-8"),
        "scipy": scipy.__version__,
    }
    return digest(content, _DIGITS)


def scipy_fit(given: Problem) -> list[Attempt]:
    """What least squares reaches from each start."""
    return [_attempt(given, theta) for theta in given.starts]


def _attempt(given: Problem, theta: np.ndarray) -> Attempt:
    from scipy.optimize import least_squares

    samples = len(given.record)
    calls = _Calls(MOST_CALLS * samples, _MOST_OF_A_SOLUTION * samples)
    held = np.arange(len(theta)) >= len(given.unknowns.law.parameters) + 2  # hidden states at the start
    solved = _residuals(given, calls)
    best = np.inf

    def residuals(x: np.ndarray) -> np.ndarray:
        nonlocal best
        result = solved(np.where(held, theta, x))
        best = min(best, float(np.sqrt((result**2).mean())))
        return result

    try:
        least_squares(residuals, theta, max_nfev=_MOST_TRIALS, x_scale="jac", diff_step=_DIFFERENCE)
    except _StoppedError:
        return Attempt(best, calls.made, stopped=True)
    return Attempt(best, calls.made, stopped=False)


def _residuals(given: Problem, calls: _Calls) -> Callable[[np.ndarray], np.ndarray]:
    """Solution minus record [m] (n,) as a function of the search vector."""
    from scipy.integrate import odeint
    from scipy.interpolate import CubicSpline

    record, unknowns = given.record, given.unknowns
    time, height = record.time, record.height
    law = unknowns.law
    field = compile_rates(law.equation, law.inputs, "numpy")
    drives = [
        (lambda t: t) if name == TIME else CubicSpline(time, input_column(record, name))
        for name in law.inputs
    ]

    def residuals(theta: np.ndarray) -> np.ndarray:
        values, z0, v0, hidden = unknowns.physical_values(theta)
        calls.of_a_solution = 0

        def rates(t: float, state: np.ndarray) -> list[Any]:
            calls.count()
            return [state[1], *field(*state, *(float(drive(t)) for drive in drives), *values)]

        full = np.full(len(time), _FAR)
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of solutions that end early
            try:
                result, told = odeint(
                    rates,
                    [z0, v0, *hidden],
                    time,
                    full_output=True,
                    tfirst=True,
                    rtol=1e-8,
                    atol=1e-10 * unknowns.amplitude,
                )
            except _GivenUpError:
                return full
        reached = len(time)
        if told["message"] != "Integration successful.":
            reached = 1 + int(np.argmax(told["tcur"] < time[1:]))
        full[:reached] = result[:reached, 0] - height[:reached]
        return np.clip(np.nan_to_num(full, nan=_FAR), -_FAR, _FAR)

    return residuals
