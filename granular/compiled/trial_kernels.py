"""Short kernels that test all of Numba's internals on which the other kernels rely."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled, entry
from granular.compiled.hook_calls import by_reference


class Weighted(NamedTuple):
    """Named tuple that the trial kernels read."""

    values: Array
    factor: float


def _weighted_sum_in_python(weighted: Weighted) -> float:
    return float(weighted.factor * weighted.values.sum())


_weighted_sum, _read_weighted_sum = compiled(_weighted_sum_in_python), compiled(_weighted_sum_in_python)


@entry
def _sum_by_compiled_kernel(weighted: Weighted) -> float:
    return _weighted_sum(by_reference(weighted))


@entry
def _sum_by_kernel_read_from_disk(weighted: Weighted) -> float:
    return _read_weighted_sum(by_reference(weighted))


def check_trial_kernels() -> None:
    """Compile the kernels, read them from disk, and check that the results agree."""
    weighted = Weighted(np.arange(4.0), 0.5)
    results = [
        kernel(weighted)
        for kernel in (_sum_by_compiled_kernel, _sum_by_kernel_read_from_disk, entry(_sum_by_compiled_kernel))
    ]
    assert results == [3.0, 3.0, 3.0], results
