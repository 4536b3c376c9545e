"""Measured orders of convergence: known error laws, wrong solvers, built-in and custom methods, and
eigenvalues.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import Method
from granular.commands.console import run_command_and_return_exit_code
from granular.linear import root_of_steps
from granular.methods import METHODS
from granular.methods.tables import register_methods
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError
from validation import exact_solution
from validation.__main__ import main
from validation.convergence_order import (
    STEEP_IN_ROOT,
    Solver,
    convergence,
    convergence_tasks,
    measure_root_convergence,
    method_name_to_plot,
    method_suits_problem,
    settled_equilibrium_and_root,
)
from validation.convergence_result import (
    BED_ROOT,
    CLEAR,
    convergence_holds,
    convergence_table,
    fit_convergence_slope,
)
from validation.exact_problems import NAMES, ExactProblem, GrainStates, exact_problem
from validation.report import method_report

STEPS = tuple(0.1 * 2.0 ** (-k / 2) for k in range(13))
COUNTS = [round(64 * 2.0 ** (k / 2)) for k in range(8)]


@pytest.mark.parametrize("order", [1, 2, 4, 6, 8])
def test_the_fitted_slope_agrees_with_a_known_power_law(order: int) -> None:
    fit = fit_convergence_slope(STEPS, [3.0 * h**order for h in STEPS], 1e-30)
    assert fit.value == pytest.approx(order, abs=1e-9)
    assert STEPS[fit.first] / STEPS[fit.last] >= 10.0 - 1e-6
    assert fit.last == len(STEPS) - 1


@pytest.mark.parametrize(("order", "length", "within"), [(4, 13, 0.05), (2, 20, 0.02)])
def test_errors_near_rounding_are_excluded_from_the_fit(order: int, length: int, within: float) -> None:
    random, rounding = np.random.default_rng(5), 1e-9
    steps = tuple(0.1 * 2.0 ** (-k / 2) for k in range(length))
    errors = [h**order + rounding * abs(random.standard_normal()) for h in steps]
    fit = fit_convergence_slope(steps, errors, rounding)
    assert (CLEAR - 4.0) * rounding < steps[fit.last] ** order
    assert order == 2 or (
        errors[-1] < 2.0 * errors[-2] and fit.last < length - 4
    )  # the finest steps err by rounding
    assert fit.value == pytest.approx(order, abs=within)


def test_a_constant_error_has_no_order_of_convergence() -> None:
    fit = fit_convergence_slope(STEPS, [h**2 + 1e-2 for h in STEPS], 1e-12)
    assert abs(fit.value) < 0.3


def plain_verlet(*, smuggled: bool = False, gravity: float = 1.0) -> Solver:
    """Return errors of Verlet in plain Python for one grain above a wall or with drag, optionally with
    mistakes.
    """

    def solve(problem: ExactProblem, count: int) -> GrainStates:
        scales, effects = Scales.from_grains(problem.scene.grains), problem.scene.effects
        weight = effects.gravity.acceleration / scales.acceleration if effects.gravity else 0.0
        rate = effects.drag.decay_rate(scales) if effects.drag else 0.0
        plan = problem.scene.arrangement
        x = np.array(plan.positions[0]) / scales.length
        v = np.zeros(2) if plan.velocities is None else np.array(plan.velocities[0])
        v = v / scales.velocity
        h = problem.time / scales.time / count
        decay = np.exp(-0.5 * h * rate)

        def kick(v: np.ndarray, x: np.ndarray) -> np.ndarray:
            wall = 0.5 * x[1] ** -3.5 if effects.walls else 0.0
            force = np.array([0.0, wall - gravity * weight])
            if smuggled:
                return v + 0.5 * h * (force - rate * v)
            return decay * v + 0.5 * h * force

        for _ in range(count):
            v = kick(v, x)
            x = x + h * v
            v = kick(v, x)
        return GrainStates(x[None] * scales.length, v[None] * scales.velocity)

    return solve


def test_a_correct_solver_has_its_declared_order() -> None:
    """Numbers of steps may be given in any order."""
    problem = exact_problem("oscillation")
    results = [
        convergence(problem, "verlet", given, solver=plain_verlet(), order=2)
        for given in (COUNTS, COUNTS[::-1], [*COUNTS[4:], *COUNTS[:4]])
    ]
    fit = results[0].fit
    assert fit.value == pytest.approx(2.0, abs=0.01)
    assert results[0].shows_declared_order(0.02)
    assert fit == results[1].fit == results[2].fit


def test_wrong_solvers_do_not_show_order_two() -> None:
    drag, problem = exact_problem("drag"), exact_problem("oscillation")
    smuggled = convergence(drag, "smuggled", COUNTS, solver=plain_verlet(smuggled=True), order=2)
    assert smuggled.fit.value == pytest.approx(1.0, abs=0.1)
    assert not smuggled.shows_declared_order(0.3)
    wrong = convergence(problem, "wrong", COUNTS, solver=plain_verlet(gravity=1.0001), order=2)
    assert not wrong.shows_declared_order(0.3)


def test_too_few_time_steps_give_no_order_of_convergence() -> None:
    counts = (64, 80, 96, 112)
    problem = exact_problem("oscillation")
    result = convergence(problem, "verlet", counts, solver=plain_verlet(), order=2)
    assert result.fit is None  # less than half a decade
    with pytest.raises(InputError, match="each 2 or more"):
        convergence(problem, "verlet", [], solver=plain_verlet(), order=2)
    assert len(convergence_table([result]).rows[0]) == len(convergence_table([result]).header)
    assert len(result.table().rows) == len(counts)
    table = result.to_dataframe()
    assert list(table) == ["step", "error", "slope", "seconds"]
    assert table["slope"][1] == result.local_slopes[0]


def test_the_toolkit_has_order_two_for_the_exact_oscillation() -> None:
    problem = exact_problem("oscillation")
    result = convergence(problem, "stormer-verlet")
    assert result.fit.value == pytest.approx(2.0, abs=0.01)
    assert result.steps[result.fit.first] / result.steps[result.fit.last] >= 10.0 - 1e-6


def test_free_fall_is_integrated_exactly() -> None:
    result = convergence(exact_problem("free-fall"), "stormer-verlet")
    assert result.is_exact
    assert result.shows_declared_order(0.0)
    assert max(result.errors) < 1e-13


TOLERANCE = {1: 0.02, 2: 0.02, 4: 0.1, 6: 0.1, 8: 0.3}


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", NAMES)
def test_every_method_converges_with_its_declared_order(name: str, method: str) -> None:
    problem = (
        exact_solution.bounce_problem(time=exact_solution.SHORT) if name == "bounce" else exact_problem(name)
    )
    if not method_suits_problem(problem, method):
        pytest.skip("does not suit the problem")
    result = convergence(problem, method_name_to_plot(method))
    if not problem.smooth:  # the stop limits the order to two
        assert result.fit.value == pytest.approx(min(2, METHODS[method].order), abs=0.1)
        return
    order = METHODS[method].order
    if order > 6 and result.fit is None:
        # Errors of order eight reach rounding within half a decade of steps.
        assert min(result.errors) < 1e-14
        return
    assert result.shows_declared_order(TOLERANCE[order]), str(convergence_table([result]))
    if order <= 6 and not result.is_exact:
        assert result.decades_of_fit > 0.99


EQUAL = [name for name, method in METHODS.items() if not method.variable and name not in STEEP_IN_ROOT]
QUICK = "stormer-verlet"


@pytest.mark.parametrize(
    "method", [QUICK, *(pytest.param(name, marks=pytest.mark.long) for name in EQUAL if name != QUICK)]
)
def test_the_discrete_eigenvalue_of_each_method_converges_with_its_declared_order(method: str) -> None:
    result = measure_root_convergence(method)
    assert result.fit is not None
    assert convergence_holds(result), (result.fit, str(result.table()))


def test_a_wrong_reference_eigenvalue_gives_no_order_of_convergence() -> None:
    exact = settled_equilibrium_and_root("stormer-verlet")[1].s
    wrong = measure_root_convergence("stormer-verlet", exact * (1.0 + 1e-4))
    assert wrong.fit is not None
    assert not convergence_holds(wrong)
    assert not wrong.shows_declared_order(0.3)


def test_the_full_report_contains_all_methods_with_equal_steps() -> None:
    tasks = [task for task in convergence_tasks(full=True) if task.key["problem"] == BED_ROOT]
    assert [task.key["method"] for task in tasks] == EQUAL


def test_a_method_without_drag_support_is_refused() -> None:
    rest, root = settled_equilibrium_and_root("stormer-verlet")
    with pytest.raises(InputError, match="does not support drag"):
        root_of_steps(rest, root, 1e-3, "runge-kutta-4")


Z = 0.1931833275037836
MCLACHLAN = Method(
    "mclachlan-2",
    2,
    "McLachlan 1995, doi:10.1137/0916010",
    kicks=(0.0, 0.5, 0.5, 0.0),
    drifts=(Z, 1.0 - 2.0 * Z, Z),
)
RUTH = Method(
    "ruth-3",
    3,
    "Ruth 1983, doi:10.1109/TNS.1983.4332919",
    kicks=(7 / 24, 3 / 4, -1 / 24, 0.0),
    drifts=(2 / 3, -2 / 3, 1.0),
)


@pytest.mark.parametrize("method", [MCLACHLAN, RUTH], ids=lambda method: method.name)
def test_custom_methods_have_their_declared_order(method: Method) -> None:
    register_methods([method])
    found = convergence(exact_problem("oscillation"), method.name)
    assert found.order == method.order
    assert found.fit.value == pytest.approx(method.order, abs=0.05)


@pytest.mark.parametrize(
    ("methods", "quantities", "words"),
    [
        ([], None, "no method is given"),
        (["nothing"], None, "unknown method 'nothing'"),
        ([Method("stormer-verlet", 1, kicks=(1.0, 0.0), drifts=(1.0,))], None, "give it another name"),
        (["pefrl"], ["energy", "nonsense"], "unknown quantity 'nonsense'"),
    ],
)
def test_invalid_requests_for_convergence_are_refused_before_measuring(
    methods: Any, quantities: Any, words: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=words):
        method_report(tmp_path, methods, **({"quantities": quantities} if quantities else {}))
    assert not list(tmp_path.iterdir())  # before anything is measured


def test_the_option_that_changes_a_scene_is_refused_if_no_scene_is_given() -> None:
    assert (
        run_command_and_return_exit_code(main, ["method", "pefrl", "--set", "grains.count=2", "--quiet"]) == 2
    )
