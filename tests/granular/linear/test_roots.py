"""Roots, modes and response of a small damper, each by another way."""

import numpy as np
import pytest

from granular.linear import dynamic_stiffness, normal_modes, piston_roots
from granular.linear.equilibrium import Equilibrium, equilibrium_from
from granular.shared.errors import InputError
from tests.granular.linear.small_beds import D, at_rest, small_damper


@pytest.fixture(scope="module")
def rest() -> Equilibrium:
    return at_rest(small_damper())


@pytest.fixture(scope="module")
def light() -> Equilibrium:
    """A bed under a piston that is as light as some grains: many modes share its motion."""
    return at_rest(small_damper(**{"piston.mass": 0.004, "effects.drag.coefficient": 0.005}))


def test_roots_solve_the_equations_of_motion(rest: Equilibrium, light: Equilibrium) -> None:
    for one in (rest, light):
        for root in piston_roots(one):
            assert np.abs(one.pencil.times(root.s, root.shape)).max() < 1e-9 * abs(root.s) ** 2
            assert root.shape[one.pencil.bed.piston] == 1.0


def test_a_light_piston_moves_by_several_roots(light: Equilibrium) -> None:
    """Their residues are those of all roots of the matrices."""
    pencil, found = light.pencil, piston_roots(light)
    size, piston = pencil.bed.size, pencil.bed.piston
    inverse = np.diag(1.0 / pencil.mass.diagonal())
    rates = np.block(
        [
            [np.zeros((size, size)), np.eye(size)],
            [-inverse @ pencil.full_stiffness, -inverse @ pencil.full_damping],
        ]
    )
    roots, shapes = np.linalg.eig(rates)
    # The answer to a unit impulse on the piston is the sum of residues times exp(s t).
    residues = shapes[piston] * np.linalg.inv(shapes)[:, size + piston] * inverse[piston, piston]
    chosen = (roots.imag > 0.0) & (np.abs(residues) >= 0.05 * np.abs(residues).max())
    assert len(found) == chosen.sum() > 1
    for root in found:
        nearest = np.argmin(np.abs(roots - root.s))
        assert roots[nearest] == pytest.approx(root.s, rel=1e-8)
        assert residues[nearest] == pytest.approx(root.residue, rel=1e-6)
    fractions = 2.0 * pencil.mass[piston, piston] * np.real(roots * residues)
    assert fractions.sum() == pytest.approx(2.0, rel=1e-9)  # each root and its conjugate
    for root in found:
        assert root.mass_fraction == pytest.approx(fractions[np.argmin(np.abs(roots - root.s))], rel=1e-6)


@pytest.mark.parametrize("drag", [1.2, 10.0])
def test_a_piston_that_creeps_is_refused(drag: float) -> None:
    """Its roots are real, though grains about it oscillate."""
    heavy = at_rest(small_damper(**{"piston.mass": 0.02, "piston.drag": drag}))
    with pytest.raises(InputError, match=r"oscillations hold \S+ of the piston's motion"):
        piston_roots(heavy)


def test_a_saddle_is_refused() -> None:
    """One grain above another: each step aside lowers the energy."""
    scene = small_damper(**{"grains.count": 2})
    width = scene.cell.width
    column = np.array([[0.5 * width, 2.0 * D], [0.5 * width, 4.0 * D]])
    saddle = equilibrium_from(scene, column, 6.0 * D)
    assert not saddle.is_stable
    with pytest.raises(InputError, match="not stable: an eigenvalue of the stiffness is -"):
        piston_roots(saddle)


def test_the_fractions_of_all_modes_add_up(rest: Equilibrium) -> None:
    modes = normal_modes(rest)
    piston = rest.pencil.bed.piston
    assert len(modes.frequencies) == 25
    assert (modes.shapes[piston] ** 2).sum() * 0.3 == pytest.approx(1.0, rel=1e-10)
    few = normal_modes(rest, 3)
    np.testing.assert_allclose(few.frequencies, modes.frequencies[:3], rtol=1e-10)


def test_the_stiffness_at_rest_is_the_weight_over_the_sag(rest: Equilibrium) -> None:
    heights = [
        equilibrium_from(
            rest.scene.replace(**{"piston.mass": 0.3 * (1.0 + change)}), rest.positions, rest.piston_height
        ).piston_height
        for change in (-1e-4, 1e-4)
    ]
    wanted = 2e-4 * 0.3 * 9.8 / (heights[0] - heights[1])
    found = dynamic_stiffness(rest, np.array([0.0]))[0]
    assert found.imag == 0.0
    assert found.real == pytest.approx(wanted, rel=1e-6)
