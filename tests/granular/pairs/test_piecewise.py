"""Tables of piecewise polynomials for pair laws: energies, forces as their derivatives, kinks and jumps."""

from collections.abc import Callable

import numpy as np
import pytest

from granular.compiled import entry
from granular.pairs import piecewise
from granular.pairs.piecewise import PiecewiseTable, Samples, tabulate_energies

tabulated_energy = entry(piecewise.tabulated_energy)
tabulated_ratio = entry(piecewise.tabulated_force_over_distance)
tabulated_slope_of_ratio = entry(piecewise.tabulated_slope_of_force_over_distance)

LOW, HIGH = 2.0**-10, 80.0


def yukawa(r: Samples) -> Samples:
    return np.exp(-2.0 * r) / r


def yukawa_force(r: Samples) -> Samples:
    return np.exp(-2.0 * r) / r * (2.0 + 1.0 / r)


def cubic_end(r: Samples) -> Samples:
    return np.maximum(2.0 - r, 0.0) ** 3


def cubic_end_force(r: Samples) -> Samples:
    return 3.0 * np.maximum(2.0 - r, 0.0) ** 2


def table_of(energy: Callable[[Samples], Samples]) -> PiecewiseTable:
    def sampled(u: Samples) -> tuple[Samples, Samples]:
        values = energy(np.sqrt(u))
        return values, np.maximum(np.abs(values), 0.1)

    return tabulate_energies([sampled], LOW, HIGH, 1e-14)


@pytest.mark.parametrize(
    ("energy", "force", "tolerance"), [(yukawa, yukawa_force, 3e-11), (cubic_end, cubic_end_force, 1e-9)]
)
def test_tabulated_energy_and_force_agree_with_the_pair_law(
    energy: Callable[[Samples], Samples], force: Callable[[Samples], Samples], tolerance: float
) -> None:
    table, r = table_of(energy), np.geomspace(0.05, 8.5, 700)
    found = np.array([[tabulated_energy(table, 0, x * x), x * tabulated_ratio(table, 0, x * x)] for x in r])
    scale = np.maximum(np.abs(force(r)), 1e-3)
    assert (np.abs(found[:, 0] - energy(r)) <= 1e-12 * np.maximum(energy(r), 1.0)).all()
    assert (np.abs(found[:, 1] - force(r)) <= tolerance * scale).all()


def test_position_of_a_jump_in_a_pair_force_is_found_accurately() -> None:
    def truncated(r: Samples) -> Samples:
        return np.where(r < 3.0, 1.0 / r - 1.0 / 3.0, 0.0)

    table = table_of(truncated)
    for r, wanted in ((3.0 - 1e-7, 1.0 / 9.0), (3.0 + 1e-7, 0.0)):
        assert r * tabulated_ratio(table, 0, r * r) == pytest.approx(wanted, abs=1e-6)
    assert (table.halves > 0).sum() < 60


def test_table_of_a_pair_law_is_extrapolated_beyond_its_ends() -> None:
    """It is extrapolated below by the first polynomial, and above by the last, which may be zero."""
    table = table_of(cubic_end)
    assert tabulated_ratio(table, 0, 1e6) == tabulated_energy(table, 0, 1e6) == 0.0
    assert tabulated_energy(table, 0, 0.0) == pytest.approx(8.0, rel=0.05)
