"""Drops of a force: where they are, how large, and how they are distributed."""

import numpy as np
import pytest

from granular.observables import drop_statistics, plastic_events
from granular.shared.errors import InputError

from .conftest import MakeRun, hexagonal


def test_drops_of_a_saw() -> None:
    values = np.array([0.0, 1.0, 0.4, 0.3, 1.5, 1.45, 2.0, 0.0])
    found = plastic_events(np.arange(8.0) * 0.1, values, 0.1)
    assert found.begin.tolist() == [1, 6]
    assert found.end.tolist() == [3, 7]
    np.testing.assert_allclose(found.size, [0.7, 2.0])
    np.testing.assert_allclose(found.time, [0.1, 0.6])
    assert len(plastic_events(np.arange(3.0), np.arange(3.0), 0.1).size) == 0


def test_exponent_of_drawn_drops(random: np.random.Generator) -> None:
    sizes = 0.2 * random.random(20_000) ** (-1.0 / 0.7)
    found = drop_statistics(sizes, 0.2)
    assert abs(found.exponent - 1.7) < 3.0 * found.error
    assert found.error < 0.01
    assert found.events == 20_000


def test_of_a_run_and_wrong_input(make_run: MakeRun) -> None:
    columns = {
        "time": np.arange(4.0),
        "piston_height": np.full(4, 0.3),
        "piston_force": np.array([1.0, 2.0, 1.5, 3.0]),
    }
    run = make_run(0.006 * np.array([hexagonal(5, 5)] * 2), columns=columns)
    force = run.dataset["piston_force"]
    found = plastic_events(force["time"].values, force.values, 0.1)
    assert found.size.tolist() == [0.5]
    with pytest.raises(InputError, match="smallest_drop 0 is not above 0"):
        plastic_events(np.arange(2.0), np.arange(2.0), 0.0)
    with pytest.raises(InputError, match="not finite"):
        plastic_events(np.arange(2.0), np.array([1.0, np.nan]), 1.0)
    with pytest.raises(InputError, match=r"drops of the shape \(2,\); finite"):
        drop_statistics(np.array([1.0, np.nan]), 1.0)
