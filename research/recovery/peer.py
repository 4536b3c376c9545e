"""Fits with SciPy's least squares and ODE solver from the same start values, for comparison."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.files import digest
from reduced_models.fitting.fit_data import fit_data_of_record
from reduced_models.fitting.parameter import SearchUnknowns
from reduced_models.fitting.problem import STARTS, TEST_FRACTION
from reduced_models.fitting.start_values import make_start_vectors, unknowns_with_typical_scales
from reduced_models.laws.equation import compile_rates
from reduced_models.laws.law import Law
from reduced_models.records.inputs import TIME, input_column

MOST_CALLS = 1500
"""Maximum number of calls of a law per sample of a record for least squares from one start.

Converging fits need 100 to 1000. Without a limit, the variable step of the solver becomes vanishingly small
for some trial parameters, and SciPy would run for hours.
"""
_MOST_OF_A_SOLUTION = 100  # maximum number of calls per sample for one solution
_MOST_TRIALS = 40
_FAR = 1e6
_DIFFERENCE = 1e-5  # relative change for finite differences, far above the solver's error
_DIGITS = 24


class LeastSquaresAttempt(NamedTuple):
    """Least squares from one start.

    Attributes
    ----------
    residual : float
        Root mean square of the best trial [m].
    calls : int
        Number of calls of the law.
    stopped : bool
        True if it was stopped at its limit of calls.
    """

    residual: float
    calls: int
    stopped: bool


class _SolutionCallLimitError(Exception):
    """A solution has reached its limit of calls."""


class _FitCallLimitError(Exception):
    """A fit has reached its limit of calls."""


@dataclasses.dataclass
class _CallCounter:
    """Number of calls of a law: in total, and for the present solution."""

    limit: int
    solution_limit: int
    made: int = 0
    solution_calls: int = 0

    def count(self) -> None:
        if self.made >= self.limit:
            raise _FitCallLimitError
        if self.solution_calls >= self.solution_limit:
            raise _SolutionCallLimitError
        self.made += 1
        self.solution_calls += 1


class RecoveryProblem(NamedTuple):
    """A record, the unknowns of a law, and the starts of the search of `fit`."""

    record: PistonRecord
    unknowns: SearchUnknowns
    starts: np.ndarray


def make_problem(record: PistonRecord, law: Law, starts: int) -> RecoveryProblem:
    """Return the problem with the first random starts of ``fit(record, law)``."""
    data = fit_data_of_record(law, record, TEST_FRACTION)
    data = dataclasses.replace(data, unknowns=unknowns_with_typical_scales(data))
    result = make_start_vectors(data, STARTS, np.random.default_rng(0), {}).theta
    return RecoveryProblem(record, data.unknowns, result[:starts])


def digest_of_problem(given: RecoveryProblem) -> str:
    """Return a digest of everything that determines SciPy's result for a problem."""
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


def fit_with_scipy_from_each_start(given: RecoveryProblem) -> list[LeastSquaresAttempt]:
    """Return the result of least squares from each start."""
    return [_fit_with_scipy(given, theta) for theta in given.starts]


def _fit_with_scipy(given: RecoveryProblem, theta: np.ndarray) -> LeastSquaresAttempt:
    from scipy.optimize import least_squares

    samples = len(given.record)
    calls = _CallCounter(MOST_CALLS * samples, _MOST_OF_A_SOLUTION * samples)
    held = np.arange(len(theta)) >= len(given.unknowns.law.parameters) + 2  # initial hidden states
    solved = _make_residual_function(given, calls)
    best = np.inf

    def residuals(x: np.ndarray) -> np.ndarray:
        nonlocal best
        result = solved(np.where(held, theta, x))
        best = min(best, float(np.sqrt((result**2).mean())))
        return result

    try:
        least_squares(residuals, theta, max_nfev=_MOST_TRIALS, x_scale="jac", diff_step=_DIFFERENCE)
    except _FitCallLimitError:
        return LeastSquaresAttempt(best, calls.made, stopped=True)
    return LeastSquaresAttempt(best, calls.made, stopped=False)


def _make_residual_function(
    given: RecoveryProblem, calls: _CallCounter
) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function of the search vector that gives solution minus record [m] (n,)."""
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
        calls.solution_calls = 0

        def rates(t: float, state: np.ndarray) -> list[Any]:
            calls.count()
            return [state[1], *field(*state, *(float(drive(t)) for drive in drives), *values)]

        full = np.full(len(time), _FAR)
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warnings of solutions that end early
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
            except _SolutionCallLimitError:
                return full
        reached = len(time)
        if told["message"] != "Integration successful.":
            reached = 1 + int(np.argmax(told["tcur"] < time[1:]))
        full[:reached] = result[:reached, 0] - height[:reached]
        return np.clip(np.nan_to_num(full, nan=_FAR), -_FAR, _FAR)

    return residuals
