"""The order of each method in the root of a bed at rest, with a wrong root as the control."""

from __future__ import annotations

import pytest

from granular.linear import root_of_steps
from granular.methods import METHODS
from granular.shared.errors import InputError
from validation.convergence_order import STEEP_IN_ROOT, convergence_tasks, root_convergence, settled_root
from validation.convergence_result import BED_ROOT, convergence_holds

EQUAL = [name for name, method in METHODS.items() if not method.variable and name not in STEEP_IN_ROOT]


QUICK = "stormer-verlet"


@pytest.mark.parametrize(
    "method", [QUICK, *(pytest.param(name, marks=pytest.mark.long) for name in EQUAL if name != QUICK)]
)
def test_each_method_has_its_order_in_the_root(method: str) -> None:
    result = root_convergence(method)
    assert result.fit is not None
    assert convergence_holds(result), (result.fit, result.table().text())


def test_a_wrong_root_shows_no_order() -> None:
    exact = settled_root("stormer-verlet")[1].s
    wrong = root_convergence("stormer-verlet", exact * (1.0 + 1e-4))
    assert wrong.fit is not None
    assert not convergence_holds(wrong)
    assert not wrong.shows_declared_order(0.3)


def test_all_methods_of_equal_steps_are_in_the_full_report() -> None:
    tasks = [task for task in convergence_tasks(full=True) if task.key["problem"] == BED_ROOT]
    assert [task.key["method"] for task in tasks] == EQUAL


def test_a_method_that_takes_no_drag_is_refused() -> None:
    rest, root = settled_root("stormer-verlet")
    with pytest.raises(InputError, match="takes no drag"):
        root_of_steps(rest, root, 1e-3, "runge-kutta-4")
