"""Kernels that the types of laws choose when the loop is compiled.

An effect gives the loop its *law*: a named tuple of numbers and arrays, whose class has the
effect's kernels as static methods, by the names of the loop's *hooks*. The laws that act are a
tuple; what is made here calls a hook of each of them, one after another, as if the calls stood in
the source. A law without the hook leaves nothing in the code. Without the compiler the same is
chosen at every call.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numba
from numba import types
from numba.extending import overload

OPTIONS: dict[str, Any] = {
    "error_model": "numpy",
    "nogil": True,
    "fastmath": {"contract"},
    "forceinline": True,
}
"""As of `granular.compiled.compiled` with ``inline``."""

Kernel = Callable[..., Any]


def sum_over(hook: str, empty: float = 0, *, backward: bool = False) -> Kernel:
    """A kernel ``(laws, rooms, *rest)`` that adds up what a hook of each law returns.

    The hook is called as ``hook(law, room, place, *rest)``, with the law's place in the tuple.

    Parameters
    ----------
    hook : str
    empty : float
        The sum where no law has the hook.
    backward : bool
        Take the last law first.
    """
    return _over(hook, _sum, empty, backward)


def greatest_over(hook: str) -> Kernel:
    """As `sum_over`, for the greatest value; 0 where no law has the hook."""
    return _over(hook, max, 0.0, False)


def last_with(hook: str, otherwise: Kernel) -> Kernel:
    """A kernel that calls the hook of the last law that has it; without one ``otherwise(*rest)``.

    It is called as `sum_over` is.
    """

    def call(laws: Any, rooms: Any, *rest: Any) -> Any:
        places = _places(hook, [type(law) for law in laws])[-1:]
        if not places:
            return otherwise(*rest)
        place = places[0]
        return getattr(laws[place], hook)(laws[place], rooms[place], place, *rest)

    def choose(laws: Any, rooms: Any, *rest: Any) -> Kernel:
        classes = _classes(laws)
        places = _places(hook, classes)[-1:]
        if places:
            return _chain(places, _kernels(hook, classes), _sum)

        def plain(laws: Any, rooms: Any, *rest: Any) -> Any:
            return otherwise(*rest)

        return plain

    return _overloaded(call, choose)


def by_law(hook: str, otherwise: Kernel) -> Kernel:
    """A kernel ``(law, *rest)`` that calls the hook of one law, or ``otherwise`` where it has none.

    Both are called with the same arguments.
    """

    def call(law: Any, *rest: Any) -> Any:
        return getattr(law, hook, otherwise)(law, *rest)

    def choose(law: Any, *rest: Any) -> Kernel:
        kernel = getattr(law.instance_class, hook, otherwise)

        def chosen(law: Any, *rest: Any) -> Any:
            return kernel(law, *rest)

        return chosen

    return _overloaded(call, choose)


def _sum(first: Any, second: Any) -> Any:
    return first + second


def _over(hook: str, join: Kernel, empty: float, backward: bool) -> Kernel:
    def call(laws: Any, rooms: Any, *rest: Any) -> Any:
        total, begun = empty, False
        places = _places(hook, [type(law) for law in laws])
        for place in places[::-1] if backward else places:
            found = getattr(laws[place], hook)(laws[place], rooms[place], place, *rest)
            total, begun = join(total, found) if begun else found, True
        return total

    def choose(laws: Any, rooms: Any, *rest: Any) -> Kernel:
        classes = _classes(laws)
        places = _places(hook, classes)
        if places:
            ordered = places[::-1] if backward else places
            return _chain(ordered, _kernels(hook, classes), join)

        def nothing(laws: Any, rooms: Any, *rest: Any) -> Any:
            return empty

        return nothing

    return _overloaded(call, choose)


def _classes(laws: types.BaseTuple) -> list[type]:
    return [law.instance_class for law in laws.types]


def _places(hook: str, classes: Sequence[type]) -> list[int]:
    return [place for place, one in enumerate(classes) if hasattr(one, hook)]


def _kernels(hook: str, classes: Sequence[type]) -> list[Kernel | None]:
    return [getattr(one, hook, None) for one in classes]


def _chain(places: Sequence[int], kernels: Sequence[Kernel | None], join: Kernel) -> Kernel:
    """Calls for these places, one after another; each place is a constant of the code."""
    place, kernel = places[0], kernels[places[0]]
    assert kernel is not None
    if len(places) == 1:

        def last(laws: Any, rooms: Any, *rest: Any) -> Any:
            return kernel(laws[place], rooms[place], place, *rest)

        return last
    others = numba.njit(**OPTIONS)(_chain(places[1:], kernels, join))
    joined = max if join is max else numba.njit(**OPTIONS)(join)

    def some(laws: Any, rooms: Any, *rest: Any) -> Any:
        first = kernel(laws[place], rooms[place], place, *rest)
        return joined(first, others(laws, rooms, *rest))

    return some


def _overloaded(call: Kernel, choose: Kernel) -> Kernel:
    """What plain Python calls, and kernels find compiled."""
    if not numba.config.DISABLE_JIT:
        overload(call, jit_options=OPTIONS)(choose)
    return call
