"""What the intervals of the laws of a bed say, on records with 1 % noise."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from reduced_models import fit


def told(made: Any, name: str, seeds: range) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each record and parameter: whether the interval holds, its half-width, the value."""
    true = made.true[name]
    holds, halves, values = [], [], []
    for seed in seeds:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = fit(made(name, seed), name, test_fraction=0.0, starts=4)
        pairs = np.array([model.intervals[key] for key in true])
        found = np.array(list(true.values()))
        holds.append((pairs[:, 0] <= found) & (found <= pairs[:, 1]))
        halves.append(0.5 * (pairs[:, 1] - pairs[:, 0]))
        values.append([model.parameters[key] for key in true])
    return np.array(holds), np.array(halves), np.array(values)


@pytest.mark.long
def test_few_records_are_held_mostly(made: Any) -> None:
    holds, _, _ = told(made, "annealing-bed", range(6))
    assert holds.mean() >= 0.75  # of 36 intervals, correlated in each record


@pytest.mark.long
@pytest.mark.parametrize("name", ["elastoplastic-bed", "annealing-bed"])
def test_intervals_hold_and_are_no_wider_than_need_be(made: Any, name: str) -> None:
    """Of 100 records; half-widths next to the scatter of the fitted values."""
    holds, halves, values = told(made, name, range(100, 200))
    fraction, width = holds.mean(axis=0), np.median(halves, axis=0) / values.std(axis=0, ddof=1)
    print(f"\n{name}: hold {fraction}, half-width over sigma {width.round(2)}")
    assert fraction.min() >= 0.85
    assert width.max() <= 2.5
