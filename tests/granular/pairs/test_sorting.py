"""Sorting of grains within kernels."""

from __future__ import annotations

import numpy as np
import pytest

from granular.compiled import entry
from granular.pairs.stripes import sort_by_value


@pytest.mark.parametrize("count", [0, 1, 2, 9, 10, 100, 721])
@pytest.mark.parametrize("levels", [3, 10**9])
def test_numbers_are_sorted_by_their_values(count: int, levels: int) -> None:
    """Any of the numbers in any order, with ties and without, and also backwards."""
    random = np.random.default_rng(count)
    values = random.integers(levels, size=2 * count).astype(float)
    for order in (random.permutation(2 * count)[:count], np.argsort(-values)[:count]):
        numbers = set(order.tolist())
        entry(sort_by_value)(order, values)
        assert set(order.tolist()) == numbers
        assert (np.diff(values[order]) >= 0.0).all()
