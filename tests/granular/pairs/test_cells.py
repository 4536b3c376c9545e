"""Close pairs by a grid of cells, whatever the places are."""

from __future__ import annotations

import numpy as np
import pytest

from granular.compiled import entry
from granular.pairs import cell_list
from granular.pairs.cell_list import close_pairs_workspace

find_close_pairs = entry(cell_list.find_close_pairs)


@pytest.mark.parametrize("far", [1.0, 1e4, 1e12, 1e15, 1e100])
def test_pairs_in_far_larger_cells_than_grains(far: float) -> None:
    """Cells of the grains' size would be more than integers count."""
    random = np.random.default_rng(3)
    places = far * random.integers(1, 5, (2, 10)) + random.uniform(0.0, 0.8, (2, 10))
    workspace = close_pairs_workspace(10, 45)
    find_close_pairs(workspace, *places, 10, 1.0, None)
    found = set(
        zip(workspace.first[: workspace.filled[0]], workspace.second[: workspace.filled[0]], strict=True)
    )
    gap = np.hypot(*(places[:, :, None] - places[:, None, :]))
    assert {tuple(sorted(map(int, pair))) for pair in found} == {
        (i, j) for i in range(10) for j in range(i + 1, 10) if gap[i, j] < 1.0
    }


@pytest.mark.parametrize("slot", [np.nan, np.inf, -np.inf])
def test_places_that_are_none(slot: float) -> None:
    workspace = close_pairs_workspace(3, 3)
    find_close_pairs(workspace, np.array([0.0, slot, 2.0]), np.zeros(3), 3, 1.0, None)
    assert workspace.filled[0] == -1
