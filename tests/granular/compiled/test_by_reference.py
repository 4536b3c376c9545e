"""Named tuples by reference: read as they are, however deep, in any kernel below."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from granular.compiled import compiled, entry
from granular.compiled.by_reference import by_reference


class Inner(NamedTuple):
    values: np.ndarray
    factor: float
    nothing: np.ndarray | None


class Outer(NamedTuple):
    flag: bool
    inner: Inner
    mixed: tuple[int, np.ndarray]
    count: int


@compiled
def _below(outer: Outer, nothing: np.ndarray | None) -> float:
    total = 0.0
    if nothing is None and outer.flag:
        for i in range(outer.count):
            outer.inner.values[i] *= outer.inner.factor
            total += outer.inner.values[i] + outer.mixed[1][i]
    return total + outer.mixed[0]


@entry
def _integer(outer: Outer) -> float:
    outer = by_reference(outer)
    return _below(outer, outer.inner.nothing)


@entry
def _other(values: np.ndarray) -> float:
    return by_reference(values)[0]


def test_fields_are_read_and_arrays_written() -> None:
    for factor in (2.0, 3.0):  # the second call reads its own fields, not those of the first
        inner = Inner(np.arange(3.0), factor, None)
        found = _integer(Outer(True, inner, (7, np.ones(3)), 3))
        assert found == 7.0 + 3.0 * factor + 3.0
        assert (inner.values == factor * np.arange(3.0)).all()
    assert _integer(Outer(False, inner, (7, np.ones(3)), 3)) == 7.0


def test_what_is_no_named_tuple_stays() -> None:
    assert _other(np.array([4.0])) == 4.0
