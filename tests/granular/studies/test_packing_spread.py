"""Expected spread of results over random packings, from a table of settled beds."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.stats import t

from granular import load_scene
from granular.studies.packing_spread import (
    NO_TABLE,
    ExpectedSpread,
    expected_packing_spread,
    read_tabulated_packings,
    relative_spread_over_packings,
)

SETS = 2000
OWN = 3
"""Number of packings that `identify` takes."""


def test_pooled_spread_weights_variances_by_degrees_of_freedom() -> None:
    pooled = ExpectedSpread(2.0, 6.0).pool_with_values([1.0, 3.0, 2.0])
    assert pooled.degrees_of_freedom == 8.0
    assert pooled.deviation**2 == pytest.approx((2.0 * 1.0 + 6.0 * 4.0) / 8.0)
    assert ExpectedSpread(2.0, 6.0).pool_with_values([5.0]) == (2.0, 6.0)


def test_interval_without_a_table_is_students_prediction_interval_for_another_packing() -> None:
    """The half-width is t s √2 about one value, and t s √(1 + 1/n) about a mean of n values."""
    values = [1.0, 3.0, 2.0]
    own = NO_TABLE.pool_with_values(values)
    assert own.half_width() == pytest.approx(t.ppf(0.975, 2) * math.sqrt(2.0))
    assert own.half_width(3) == pytest.approx(t.ppf(0.975, 2) * math.sqrt(4.0 / 3.0))


def test_prediction_intervals_from_three_packings_and_the_table_contain_a_fourth_in_95_percent() -> None:
    """Four packings are drawn 2000 times, and removed from the table.

    From 92 to 98 % of the intervals contain the fourth, and their widths are similar. Without the table,
    the widths of Student's intervals vary by a factor above 3.
    """
    figures = read_tabulated_packings()["damper"]
    random = np.random.default_rng(20)
    hits, widths, without = np.zeros(3), [], []
    for _ in range(SETS):
        order = random.permutation(len(figures))
        own, other, table = np.split(figures[order], [OWN, OWN + 1])
        relative = relative_spread_over_packings(table)
        rows = []
        for k, expected in enumerate(relative[:3]):
            absolute = expected._replace(deviation=expected.deviation * float(table[:, k].mean()))
            known = NO_TABLE if absolute.is_contradicted_by(own[:, k]) else absolute
            rows.append(known.pool_with_values(own[:, k]).half_width())
        widths.append(rows)
        without.append([NO_TABLE.pool_with_values(own[:, k]).half_width() for k in range(3)])
        hits += np.abs(other[0] - own[0]) <= rows
    low, high = np.percentile(widths, [10, 90], axis=0)
    assert np.all((hits >= 0.92 * SETS) & (hits <= 0.98 * SETS))
    assert np.all(high <= 2.0 * low)
    low, high = np.percentile(without, [10, 90], axis=0)
    assert np.all(high > 3.0 * low)


def test_packings_that_scatter_much_more_than_expected_contradict_the_table() -> None:
    expected = ExpectedSpread(1.0, 29.0)
    assert not expected.is_contradicted_by([0.0, 3.0, 1.0])
    assert expected.is_contradicted_by([0.0, 12.0, 1.0])
    assert not expected.is_contradicted_by([5.0])
    assert not NO_TABLE.is_contradicted_by([0.0, 12.0, 1.0])


def test_the_table_of_packings_contains_thirty_packings_of_the_packaged_damper() -> None:
    figures = read_tabulated_packings()["damper"]
    assert figures.shape == (30, 3)
    assert len(np.unique(figures[:, 1])) > 20
    variance = sum((value - figures[:, 2].mean()) ** 2 for value in figures[:, 2]) / 29.0
    found = relative_spread_over_packings(figures).damping_ratio
    assert found.deviation * figures[:, 2].mean() == pytest.approx(math.sqrt(variance))
    assert found.degrees_of_freedom == 29.0


@pytest.mark.parametrize(
    ("changes", "known"),
    [
        ({"arrangement.seed": 7}, True),
        ({"protocol.lift.by": "0.5 D", "name": "my damper", "output.frames": 0.2}, True),
        ({"protocol.lift.by": "1 D"}, False),
        ({"output.record": "drop"}, False),
        ({"grains.count": 330}, False),
        ({"piston.mass": 7.6}, False),
        ({"arrangement.height": "18 D"}, False),
        ({"effects.friction": {"static": 0.1, "dynamic": 0.1}}, False),
        ({"piston.friction": 0.05}, False),
        ({"grains.spread": 0.1}, False),
    ],
)
def test_the_table_of_packings_is_used_only_for_the_same_bed_and_motion(
    changes: dict[str, Any], known: bool
) -> None:
    found = expected_packing_spread(load_scene("damper").replace(**changes))
    assert (found is not None) == known
    assert not known or found == relative_spread_over_packings(read_tabulated_packings()["damper"])
