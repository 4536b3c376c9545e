"""One-line kernels that use all Numba internals on which the other kernels rely."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled, entry
from granular.compiled.hook_calls import by_reference


class Weighted(NamedTuple):
    """Values and their common factor."""

    values: Array
    factor: float


def _weigh(weighted: Weighted) -> float:
    return float(weighted.factor * weighted.values.sum())


_weighted_sum, _read_weighted_sum = compiled(_weigh), compiled(_weigh)


@entry
def _sum(weighted: Weighted) -> float:
    return _weighted_sum(by_reference(weighted))


@entry
def _sum_of_read(weighted: Weighted) -> float:
    return _read_weighted_sum(by_reference(weighted))


def run() -> None:
    """Compile the kernels, read them from disk, and compare their results."""
    weighted = Weighted(np.arange(4.0), 0.5)
    results = [kernel(weighted) for kernel in (_sum, _sum_of_read, entry(_sum))]
    assert results == [3.0, 3.0, 3.0], results
