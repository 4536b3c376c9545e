"""Order of convergence: the power of the time step with which the error of a method decreases.

The error is the deviation from the exact solution. The order is the slope of the error against the step on
logarithmic axes, fitted to the finest decade of steps whose error is well above rounding. Rounding is
measured at the finest step in two ways. Runs from initial positions that differ by one or two units in the
last place show random rounding. Runs with one step more and one step fewer show rounding that is the same in
every step: it appears in the second difference of the final states. The truncation error is smooth, so its
second difference is smaller by the square of the number of steps. Coarser runs take fewer steps and have
smaller rounding errors.

If a motion is not smooth, for example when friction stops a grain, the error depends on the moment of that
event within its step. The error is then the maximum over 21 neighbouring numbers of steps.
"""

from __future__ import annotations

import dataclasses
import math
import time
import warnings
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.linear import Root, piston_roots, root_of_steps
from granular.linear.equilibrium import Equilibrium, equilibrium_from, settled_scene_positions_and_heights
from granular.methods import METHODS, method_named
from granular.methods.method import COMPENSATED
from granular.scene.named_scenes import load_scene
from granular.shared.blocks import Text
from granular.shared.errors import InputError, RunError
from validation import exact_solution, external_integrators
from validation.convergence_result import (
    BED_ROOT,
    CLEAR,
    HIGH_ORDER,
    ConvergenceResult,
    convergence_blocks,
    convergence_table,
    convergence_verdict_and_passed,
    fit_convergence_slope,
    fit_slope_with_interval,
)
from validation.exact_problems import NAMES, exact_problem
from validation.exact_solution import ExactProblem, GrainStates
from validation.report_tasks import Section, Task

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory

COARSE = {1: 1e-2}
COARSE_OTHERWISE = 1e-3
"""Maximum error with the longest step, divided by a grain's diameter. `COARSE` is for methods of order one,
for which a smaller error would be too expensive; `COARSE_OTHERWISE` is for all other methods."""

LONGER = 4.0
"""Factor by which the longest step is increased for methods of order `HIGH_ORDER` and more. From the longest
step to a tenth of it their error falls by six decades or more, and all these errors must exceed rounding."""

LATER = 4.0
"""Factor by which the longest step is reduced for methods of order one. At long steps the second-order term
of their error would bend the line of error against step."""

# Some 15 s for a lone grain under gravity, at 0.2 us a step; a solver still too coarse at a sixteenth of
# that number of steps is run there anyway, and its table shows the error.
MOST_STEPS = 2**26
NUDGES = (1, -1, 2)
POINTS = 10
"""Number of different step counts with which a problem is solved."""
# A Fibonacci number: with `SLIDING_TIME` near the golden ratio, the stops are then spread evenly over the
# step.
NEIGHBOURS = 21

FIRST_ROOT_STEP, MOST_ROOT_STEPS, ROOT_COARSE = 0.7, 20, 1e-2
"""Step sizes for the characteristic root s of a small motion exp(s t). The longest step is at most
`FIRST_ROOT_STEP`/|s|, with a relative error of s of at most `ROOT_COARSE`. There are at most
`MOST_ROOT_STEPS` step sizes."""

NEAR = 1e-4
"""Relative difference between three neighbouring step sizes; the second difference of their errors shows
rounding. Even without rounding, an error of order 8 has a second difference of 6e-7 of the error; at a
relative error of 2e-4 this equals rounding."""

ROOT_ORDERS = {"symplectic-euler": 2}
"""Methods whose roots converge with another order than declared. The symplectic Euler method is Verlet's
method shifted by half a step, so both maps have the same multipliers."""

STEEP_IN_ROOT = ("yoshida-6", "kahan-li-6")
"""Methods whose roots do not reach the declared order before rounding sets in. Their slopes fall towards 6;
at the finest steps they are 6.44, 6.23, 6.12 (kahan-li-6) and 6.13, 6.07, 6.04 (yoshida-6)."""

Solver = Callable[[ExactProblem, int], GrainStates]
"""Function that solves a problem in a number of equal steps and returns the final states of the grains."""


def make_toolkit_solver(method: str) -> Solver:
    """Make the solver that integrates by a method of the toolkit."""
    # A variable-step method gets the multiple of its automatic step that gives about the same number of
    # steps.
    from granular.run.simulation import simulate

    variable = method_named(method).variable
    automatic: dict[str, int] = {}

    def time_step_for_count(problem: ExactProblem, count: int) -> float | str:
        if not variable:
            return problem.time / count
        if problem.name not in automatic:
            automatic[problem.name] = int(run_problem_with_step(problem, "auto").settings()["steps"])
        return f"auto*{automatic[problem.name] / count:.15f}"

    def run_problem_with_step(problem: ExactProblem, dt: float | str) -> Trajectory:
        scene = problem.scene
        if not isinstance(dt, str) and dt > scene.output.scalars:
            scene = scene.replace(**{"output.scalars": dt, "output.frames": dt})
        with warnings.catch_warnings(action="ignore"):  # the error is measured and shown here
            return simulate(scene, dt=dt, t_end=problem.time, method=method, threads=1, progress=False)

    def final_states_for_step_count(problem: ExactProblem, count: int) -> GrainStates:
        done = run_problem_with_step(problem, time_step_for_count(problem, count))
        data, steps = done.dataset, int(done.settings()["steps"])
        return GrainStates(
            data["position"].values[-1], data["velocity"].values[-1], steps if variable else None
        )

    return final_states_for_step_count


def choose_step_counts(problem: ExactProblem, solver: Solver, order: int) -> tuple[int, ...]:
    """Return step counts that increase by factors of sqrt(2), from the first whose error is small enough."""
    exact = problem.exact(problem.time).positions
    coarse = COARSE.get(order, COARSE_OTHERWISE) * problem.scene.grains.species[0].diameter
    start = problem.fewest_steps / (LONGER if order >= HIGH_ORDER else 1.0)
    while start < MOST_STEPS / 16 and not _is_step_count_fine_enough(
        problem, solver, round(start), exact, coarse
    ):
        start *= math.sqrt(2.0)
    start *= LATER if order == 1 else 1.0
    return tuple(round(start * math.sqrt(2.0) ** k) for k in range(POINTS))


def _is_step_count_fine_enough(
    problem: ExactProblem, solver: Solver, count: int, exact: np.ndarray, coarse: float
) -> bool:
    try:
        return bool(np.abs(solver(problem, count).positions - exact).max() < coarse)
    except (RunError, InputError):
        return False  # a run with too long a step may be refused or stopped


def method_suits_problem(problem: ExactProblem, method: str) -> bool:
    """Return True if the method can run the problem."""
    # Some methods do not support dry friction. Variable steps follow distances, so the scene needs distances.
    from granular.run.plan import can_run

    effects = problem.scene.effects
    distances = effects.dipole is not None or effects.walls is not None
    variable = method_named(method).variable
    return can_run(problem.scene, "auto", method) and (distances or not variable)


def convergence(
    problem: ExactProblem,
    method: str,
    counts: Sequence[int] | None = None,
    *,
    solver: Solver | None = None,
    order: int | None = None,
) -> ConvergenceResult:
    """Measure a method's order of convergence on an exact problem.

    The order is the slope of the error against the step on logarithmic axes; see `fit_convergence_slope`.
    If the motion is not smooth, each error is the maximum over 21 neighbouring numbers of steps.

    Parameters
    ----------
    problem : ExactProblem
        Exact problem.
    method : str
        Name as in `granular.methods.method_named`; any name if solver and order are given.
    counts : sequence of int, optional
        Numbers of equal steps up to the problem's time (approximate for variable steps), integers from 2, in
        any order. Default: `choose_step_counts`.
    solver : callable, optional
        Integration used as a control instead of the toolkit's: maps a problem and a number of steps to
        `GrainStates`.
    order : int, optional
        Declared order of the solver. Default: the method's order.

    Returns
    -------
    ConvergenceResult
        Error [m] and wall time [s] for each step [s], the rounding error [m], and the measured order with its
        interval, dimensionless. An order is measured only if the errors clearly exceed rounding at four or
        more step sizes over at least half a decade; otherwise it is None.

    Raises
    ------
    InputError
        If the method is unknown or cannot run the problem's scene, or if ``counts`` holds a number below 2.
    RunError
        If a run fails, for example because the caller's steps are too coarse for the problem.

    Examples
    --------
    >>> from validation import convergence, exact_problem
    >>> round(convergence(exact_problem("oscillation"), "stormer-verlet").fit.value, 2)
    2.0
    """
    order = method_named(method).order if order is None else order
    solve = make_toolkit_solver(method) if solver is None else solver
    counts = choose_step_counts(problem, solve, order) if counts is None else tuple(sorted(counts))
    if not counts or min(counts) < 2:
        raise InputError(f"counts = {counts}; give numbers of steps, each 2 or more")
    exact = problem.exact(problem.time).positions
    solve(problem, counts[0])  # compiles, so that wall times exclude compilation
    steps, errors, seconds = [], [], []
    for count in counts:
        started = time.perf_counter()
        more = range(1 if problem.smooth else NEIGHBOURS)
        neighbours = [solve(problem, count + by) for by in more]
        seconds.append((time.perf_counter() - started) / len(neighbours))
        errors.append(max(float(np.abs(state.positions - exact).max()) for state in neighbours))
        steps.append(problem.time / (neighbours[0].steps or count))
    rounding = _rounding_error(problem, solve, counts[-1], neighbours[0].positions)
    return ConvergenceResult(
        problem.name,
        method,
        order,
        problem.smooth,
        tuple(steps),
        tuple(errors),
        rounding,
        fit_convergence_slope(steps, errors, rounding),
        tuple(seconds),
    )


def _rounding_error(problem: ExactProblem, solve: Solver, count: int, plain: np.ndarray) -> float:
    differences = [
        solve(problem.perturb_start(last_place_units), count).positions - plain for last_place_units in NUDGES
    ]
    if problem.smooth:
        less, more = (solve(problem, count + by).positions for by in (-1, 1))
        differences.append((less - plain) + (more - plain))
    # The exact position itself is known only to half a unit in its last place.
    return max(
        *(float(np.abs(difference).max()) for difference in differences),
        float(np.spacing(np.abs(plain).max())),
    )


# Roots ----------------------------------------------------------------------------------------

# A piston as light as three magnets has a root near the grains' roots: a step that resolves them all is
# then long enough for the piston's error to exceed rounding.
CHANGES: dict[str, Any] = {
    "grains.count": 3,
    "cell.width": "3 D",
    "piston.mass": 0.002,
    "piston.height": "6 D",
    "arrangement.height": "5 D",
    "effects.drag.coefficient": 0.01,
}


@cache
def _equilibria_and_roots_by_drag() -> dict[bool, tuple[Equilibrium, Root]]:
    """Return equilibrium and exact characteristic root, with (key True) and without drag (False)."""
    scene, positions, height = settled_scene_positions_and_heights(load_scene("damper").replace(**CHANGES))
    result = {}
    for drags in (False, True):
        variant = scene if drags else scene.replace(**{"effects.drag": None})
        rest = equilibrium_from(variant, positions, height)
        result[drags] = rest, piston_roots(rest)[0]
    return result


def settled_equilibrium_and_root(method: str) -> tuple[Equilibrium, Root]:
    """Return the equilibrium for measuring a method's characteristic root, and the exact root there."""
    return _equilibria_and_roots_by_drag()[method_named(method).tableau is None]


def relative_root_error(method: str, dt: float, exact: complex | None = None) -> float:
    """Return the relative error of a method's characteristic root at a step [s]; ``exact`` is in 1/s."""
    rest, root = settled_equilibrium_and_root(method)
    exact = root.s if exact is None else exact
    return abs(root_of_steps(rest, root, dt, method) - exact) / abs(exact)


def measure_root_convergence(method: str, exact: complex | None = None) -> ConvergenceResult:
    """Measure how a method's characteristic root converges; ``exact`` [1/s] replaces the exact root.

    The slope is fitted over two halvings of the step. Errors [m] are given for an oscillation with an
    amplitude of one diameter, after a phase of one radian.
    """
    rest, root = settled_equilibrium_and_root(method)
    diameter = rest.scene.grains.species[0].diameter
    steps: list[float] = []
    errors: list[float] = []
    seconds: list[float] = []
    rounding = 0.0
    for k in range(MOST_ROOT_STEPS):
        step = FIRST_ROOT_STEP / abs(root.s) * math.sqrt(0.5) ** k
        started = time.perf_counter()
        less, error, more = (
            diameter * relative_root_error(method, step * by, exact) for by in (1.0 - NEAR, 1.0, 1.0 + NEAR)
        )
        noise = max(rounding, abs(less - 2.0 * error + more), float(np.spacing(diameter)))
        if error > ROOT_COARSE * diameter and not steps:
            continue
        if error <= CLEAR * noise:
            break
        steps.append(step)
        errors.append(error)
        seconds.append((time.perf_counter() - started) / 3.0)
        rounding = noise
    order = ROOT_ORDERS.get(method, method_named(method).order)
    last = len(steps) - 1
    fit = fit_slope_with_interval(steps, errors, last - 4, last) if last >= 4 else None
    return ConvergenceResult(
        BED_ROOT, method, order, True, tuple(steps), tuple(errors), rounding, fit, tuple(seconds)
    )


# In the report ----------------------------------------------------------------------------------

QUICK_METHODS = ("stormer-verlet", "blanes-moan-4", "yoshida-6")
"""Methods of the quick report, which run on every problem and share compiled code."""

QUICK_PROBLEM = "oscillation"
"""Problem that is run with all methods, also in the quick report."""

OUTSIDE_PROBLEMS = ("oscillation", "bounce", "scattering", "drag")
"""Problems for the external integrators; the quick report takes the first one."""


def convergence_tasks(full: bool) -> list[Task]:
    """Make the tasks that measure every method on every exact problem that it can run."""
    return [
        *(
            convergence_task(method_name_to_plot(method), name, full)
            for name in NAMES
            for method in METHODS.built_in
            if (full or method in QUICK_METHODS or name == QUICK_PROBLEM)
            and method_suits_problem(exact_problem(name), method)
        ),
        *(
            Task(
                f"{method} on {BED_ROOT}",
                {"problem": BED_ROOT, "method": method},
                partial(measure_root_convergence, method),
            )
            for method in METHODS.built_in
            if (full or method in QUICK_METHODS)
            and not method_named(method).variable
            and method not in STEEP_IN_ROOT
        ),
        *(
            convergence_task(reference, name, full)
            for name in (OUTSIDE_PROBLEMS if full else OUTSIDE_PROBLEMS[:1])
            for reference in external_integrators.ORDERS
        ),
    ]


def convergence_task(method: str, problem: str, full: bool, **more: Any) -> Task:
    """Make the task that measures one method's order on one exact problem."""
    key = {"problem": problem, "method": method, "full": full, **more}
    return Task(f"{method} on {problem}", key, partial(_measure_convergence, problem, method, full))


def method_name_to_plot(name: str) -> str:
    """Return the name of the variant to plot, with compensated sums for methods of high order."""
    # Six decades of error fit above rounding only with compensated sums.
    method = method_named(name)
    high = method.order >= HIGH_ORDER and method.tableau is None
    return f"{name}{COMPENSATED}" if high else name


def _measure_convergence(name: str, method: str, full: bool) -> ConvergenceResult:
    # Methods of order one would need too many steps for all of de Paula's 2 s. High-order methods have too
    # few steps that resolve every turn and are still clear of rounding.
    reference = method in external_integrators.ORDERS
    short = not full or reference or _needs_short_bounce(method)
    problem = exact_problem(name)
    if short and name == "bounce":
        problem = exact_solution.bounce_problem(time=exact_solution.SHORT)
    if not reference:
        return convergence(problem, method)
    solve, order = external_integrators.make_external_solver(method), external_integrators.ORDERS[method]
    # A Runge-Kutta method reaches its order only at shorter steps than a symmetric composition.
    finer = dataclasses.replace(problem, fewest_steps=2 * problem.fewest_steps)
    return convergence(problem, method, choose_step_counts(finer, solve, order), solver=solve, order=order)


def _needs_short_bounce(method: str) -> bool:
    chosen = method_named(method)
    return chosen.order == 1 or chosen.order >= HIGH_ORDER or chosen.tableau is not None


CONVERGENCE = Section(
    "convergence",
    "Order of convergence",
    convergence_tasks,
    ConvergenceResult,
    convergence_verdict_and_passed,
    convergence_blocks,
    lambda results: [Text("Orders of convergence."), convergence_table(results)],
)
