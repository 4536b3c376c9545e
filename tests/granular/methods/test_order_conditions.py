"""Order conditions checked with methods of known order, and with the numbers of rooted trees."""

import random

import pytest

from granular.methods import METHODS, Method
from granular.methods.method import (
    HIGHEST_ORDER,
    _rooted_trees,
    failed_composition_condition,
    failed_order_condition,
)
from granular.shared.errors import InputError


@pytest.mark.parametrize("name", METHODS)
def test_built_in_integration_methods_have_exactly_their_stated_order(name: str) -> None:
    method = METHODS[name]
    for order, failed in ((method.order, False), (method.order + 1, True)):
        if method.tableau is None:
            found = failed_composition_condition(method.kicks, method.drifts, order)
        else:
            found = failed_order_condition(method.tableau, order)
        assert (found is not None) is failed
    assert f"order {method.order + 1} needs" in str(found)


def test_numbers_of_rooted_trees_are_correct() -> None:
    """They are sequence A000081 of the On-Line Encyclopedia of Integer Sequences."""
    counts = [len(_rooted_trees(nodes)) for nodes in range(1, HIGHEST_ORDER + 1)]
    assert counts == [1, 1, 2, 4, 9, 20, 48, 115, 286, 719]
    assert len(set(_rooted_trees(8))) == 115


def test_an_error_in_a_coefficient_of_a_method_violates_an_order_condition() -> None:
    """An error of 1e-6 is added to one coefficient of each composition method."""
    draw = random.Random(1)
    for method in METHODS.values():
        if method.tableau is not None:
            continue
        coefficients = [*method.kicks, *method.drifts]
        index = draw.choice([k for k, value in enumerate(coefficients) if value])
        coefficients[index] += 1e-6
        kicks, drifts = coefficients[: len(method.kicks)], coefficients[len(method.kicks) :]
        assert failed_composition_condition(kicks, drifts, method.order) is not None


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"kicks": (0.5, 0.6), "drifts": (1.0,)}, "order 1 needs 1/1 for the word K"),
        ({"kicks": (0.4, 0.6), "drifts": (1.0,)}, "order 2 needs 1/2 for the word K D"),
        ({"kicks": (0.5,), "drifts": (1.0,)}, "one kick more than drifts"),
        ({"kicks": (0.5, 0.5), "drifts": (float("nan"),)}, "nan"),
        ({"kicks": (0.5, 0.5), "drifts": "1"}, "list of numbers"),
        ({"kicks": (0.5, 0.5), "drifts": (True,)}, "True"),
        ({"kicks": (0.0,) * 100, "drifts": (0.0,) * 99}, "65 or fewer"),
        ({"order": 11, "kicks": (0.5, 0.5), "drifts": (1.0,)}, "order = 11"),
        ({"order": 2.0, "kicks": (0.5, 0.5), "drifts": (1.0,)}, "order = 2.0"),
        ({"name": "", "kicks": (0.5, 0.5), "drifts": (1.0,)}, "printable"),
        ({"tableau": ((0.0,), (1.0,))}, r"order 2 needs 1/2 for the tree \[\[\]\]"),
        ({"tableau": ((1.0,), (1.0,))}, "implicit in row 0"),
        ({"tableau": ((0.0, 0.0), (1.0,))}, "s rows of s numbers"),
        ({"tableau": ((0.0,), (1.0,)), "compensated": True}, "remove variable"),
        ({"tableau": ((0.0,), (1.0,)), "drifts": (1.0,)}, "give one of them"),
        ({"kicks": (0.0, 1.0, 0.0), "drifts": (0.5, 0.5), "variable": True}, "variable steps require"),
    ],
)
def test_invalid_coefficients_of_a_method_give_a_one_line_error(table: dict, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        Method(**{"name": "mine", "order": 2, **table})
    assert "\n" not in str(caught.value)
