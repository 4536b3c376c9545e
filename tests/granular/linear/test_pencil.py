"""Products of a vector and Krylov's method against full matrices."""

import numpy as np
import pytest

from granular.linear import normal_modes, piston_roots, slopes
from granular.linear import pencil as pencils
from granular.linear.equilibrium import Equilibrium, equilibrium_from
from granular.linear.pencil import Pencil
from tests.granular.linear.small_beds import at_rest, small_damper

KEYS = ("grains.remanence", "piston.mass", "cell.width", "effects.drag.coefficient")


@pytest.fixture(scope="module")
def rest() -> Equilibrium:
    return at_rest(
        small_damper(
            **{
                "grains.count": 92,
                "cell.width": "30 D",
                "piston.height": "10 D",
                "arrangement.height": "9.5 D",
                "piston.mass": 3.75,
            }
        )
    )


def solve_by_full_matrices(
    pencil: Pencil, s: complex, right: np.ndarray, held: tuple[int, ...] = ()
) -> np.ndarray:
    free = np.delete(np.arange(pencil.bed.size), list(held))
    matrix = pencil.full_stiffness + s * pencil.full_damping + s * s * pencil.mass.toarray()
    result = np.zeros(right.shape, np.result_type(right, s))
    result[free] = np.linalg.solve(matrix[np.ix_(free, free)], right[free])
    return result


def test_krylov_takes_the_equilibrium_root_and_slopes_of_full_matrices(
    rest: Equilibrium, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = piston_roots(rest)[0]
    found = slopes(rest, KEYS, first).values
    monkeypatch.setattr(Pencil, "solve", solve_by_full_matrices)
    direct = equilibrium_from(rest.scene, rest.positions + 1e-5, rest.piston_height)
    np.testing.assert_allclose(direct.positions, rest.positions, rtol=0.0, atol=1e-7 * 0.006)
    assert direct.piston_height == pytest.approx(rest.piston_height, rel=1e-9)
    again = piston_roots(direct)[0]
    assert again.s == pytest.approx(first.s, rel=1e-7)
    assert again.mass_fraction == pytest.approx(first.mass_fraction, rel=1e-7)
    np.testing.assert_allclose(found, slopes(direct, KEYS, again).values, rtol=1e-7, atol=1e-7)


def test_the_lowest_modes_of_a_large_bed_are_those_of_full_matrices(
    rest: Equilibrium, monkeypatch: pytest.MonkeyPatch
) -> None:
    stiffness, frequencies = rest.lowest_stiffness, normal_modes(rest, 4).frequencies
    monkeypatch.setattr(pencils, "DENSE", 0)
    large = equilibrium_from(rest.scene, rest.positions, rest.piston_height)
    assert not large.pencil.has_all_modes
    np.testing.assert_allclose(large.lowest_stiffness, stiffness, rtol=1e-5)
    np.testing.assert_allclose(normal_modes(large, 4).frequencies, frequencies, rtol=1e-6)
