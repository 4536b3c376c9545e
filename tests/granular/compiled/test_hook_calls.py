"""The hooks of laws are called in compiled code in their order, with their rooms and places."""

from typing import Any, NamedTuple

import numba
import numpy as np
import pytest

from granular.compiled import entry
from granular.compiled.hook_calls import call_hook, call_last_hook, greatest_of_hooks, sum_of_hooks


class Quiet(NamedTuple):
    """It returns a constant, which has a type of its own."""

    size: float

    @staticmethod
    @numba.njit
    def act(law: Any, workspace: Any, place: int, values: Any) -> int:
        return 0

    @staticmethod
    @numba.njit
    def reach(law: Any, workspace: Any, place: int, at: float) -> float:
        return law.size * at


class Loud(NamedTuple):
    size: float
    values: np.ndarray

    @staticmethod
    @numba.njit
    def act(law: Any, workspace: Any, place: int, values: Any) -> int:
        values[0] = 10.0 * values[0] + place
        return 1 if values[0] > 0.0 else 0

    @staticmethod
    @numba.njit
    def reach(law: Any, workspace: Any, place: int, at: float) -> float:
        return law.size * at + workspace[0]


class Idle(NamedTuple):
    size: float


@numba.njit
def _silent(values: Any) -> int:
    return -1


@numba.njit
def _without(law: Any, at: float) -> int:
    return -1


LAWS = (Quiet(1.0), Loud(2.0, np.ones(2)), Idle(0.5), Loud(3.0, np.ones(3)))
WORKSPACES = (None, np.array([0.5]), None, np.array([7.0]))

forward, backward = sum_of_hooks("act", "values"), sum_of_hooks("act", "values", backward=True)
greatest, last = greatest_of_hooks("reach", "at"), call_last_hook("act", "values", _silent)
chosen = call_hook("nothing", "at", _without)


@entry
def every(laws: Any, workspaces: Any, values: Any) -> Any:
    return (
        forward(laws, workspaces, values),
        backward(laws, workspaces, values),
        greatest(laws, workspaces, 2.0),
        last(laws, workspaces, values),
        chosen(laws[0], 1.0),
    )


@pytest.mark.parametrize("places", [(0, 1, 2, 3), (1, 2), (2,)], ids=str)
def test_hooks_are_called_in_order_with_their_rooms_and_places(places: tuple[int, ...]) -> None:
    laws, workspaces = (tuple(one[place] for place in places) for one in (LAWS, WORKSPACES))
    values = np.array([0.0])
    found = every(laws, workspaces, values)
    acting = [place for place, law in enumerate(laws) if isinstance(law, Loud)]
    digits, counts = 0.0, []
    for order in (acting, acting[::-1], acting[-1:]):
        count = 0
        for place in order:
            digits = 10.0 * digits + place
            count += digits > 0.0
        counts.append(count)
    reaches = [
        2.0 * law.size + (0.0 if workspace is None else workspace[0])
        for law, workspace in zip(laws, workspaces, strict=True)
        if not isinstance(law, Idle)
    ]
    assert values[0] == digits
    assert found == (*counts[:2], max(reaches, default=0.0), counts[2] if acting else -1, -1)
