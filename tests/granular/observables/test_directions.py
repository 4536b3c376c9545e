"""Modes, directions and correlations: made-up values whose answer is known."""

import numpy as np
import pytest

from granular.observables import axial_order_parameter, dip_test, spatial_correlation
from granular.observables.statistics import dip_statistic
from granular.shared.errors import InputError
from tests.granular.observables.conftest import hexagonal


def test_two_modes_are_told_from_one(random: np.random.Generator) -> None:
    one = random.normal(2.0, 0.3, 80)  # as many as below: their distribution is simulated once
    two = np.concatenate([one[:40] - 0.6, one[40:] + 0.6])
    found = dip_test(two)
    assert found.p < 0.01
    assert dip_test(one).p > 0.1
    assert found.dip == pytest.approx(dip_test(10.0 * two - 3.0).dip, rel=1e-9)


def test_dip_of_two_atoms_is_known() -> None:
    """Half of all values at either of two places: 1/4 as both become points (Hartigan 1985)."""
    values = np.concatenate([np.linspace(0.0, 1e-6, 200), np.linspace(1.0, 1.0 + 1e-6, 200)])
    assert dip_statistic(values) == pytest.approx(0.25, abs=0.005)


def test_uniform_values_seldom_look_like_two_modes(random: np.random.Generator) -> None:
    p = np.array([dip_test(random.random(80)).p for _ in range(200)])
    assert 0.01 <= (p < 0.05).mean() <= 0.11


def test_too_few_values_are_an_input_error() -> None:
    with pytest.raises(InputError, match="3 values; the dip test needs at least 4"):
        dip_test(np.array([1.0, 2.0, np.nan, 3.0]))


def test_directions(random: np.random.Generator) -> None:
    """Vectors along a line have axial order alone; those of a fan a polar one as well."""
    none = axial_order_parameter(random.normal(size=(400, 2)))
    assert min(none.polar_p, none.axial_p) > 0.01
    line = np.outer(random.choice([-1.0, 1.0], 400), [1.0, 2.0])
    found = axial_order_parameter(line)
    assert found.axial == pytest.approx(1.0)
    assert found.polar < 0.2
    assert found.axial_p < 1e-12
    assert axial_order_parameter(np.abs(line)).polar == pytest.approx(1.0)
    assert axial_order_parameter(np.array([[1.0, 0.0], [np.nan, 1.0], [0.0, 0.0]])).vectors == 1
    with pytest.raises(InputError, match="0 vectors"):
        axial_order_parameter(np.zeros((3, 2)))


def test_rayleigh_p_is_a_probability(random: np.random.Generator) -> None:
    p = np.array([axial_order_parameter(random.normal(size=(30, 2))).axial_p for _ in range(2000)])
    for level in (0.05, 0.3):
        assert (p < level).mean() == pytest.approx(level, abs=3.5 * np.sqrt(level / 2000))


def test_spatial_correlation(random: np.random.Generator) -> None:
    """Stripes of two rows: alike within, opposite between; independent values have none."""
    positions = hexagonal(24, 24)
    edges = np.array([0.9, 1.1])
    rows = np.repeat(np.arange(24) % 2, 24)
    striped = spatial_correlation(positions, rows, edges)
    near = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    i, j = np.nonzero(np.triu((near > 0.9) & (near <= 1.1)))
    wanted = np.mean((rows[i] - 0.5) * (rows[j] - 0.5)) / 0.25
    assert striped.values[0] == pytest.approx(wanted)
    assert striped.pairs[0] == len(i)
    noise = spatial_correlation(positions, random.normal(size=576), edges).values[0]
    assert abs(noise) < 4.0 / np.sqrt(striped.pairs[0])
    with pytest.raises(InputError, match="do not differ"):
        spatial_correlation(positions, np.ones(576), edges)
