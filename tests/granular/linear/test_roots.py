"""Roots, modes, response and sensitivities of a small damper, each checked by an independent method."""

from typing import Any

import numpy as np
import pytest

from granular.linear import dynamic_stiffness, normal_modes, piston_roots, slopes
from granular.linear.bed_forces import scene_with_scaled_value
from granular.linear.equilibrium import Equilibrium, equilibrium_from
from granular.linear.small_motions import keys_of_nonzero_numbers
from granular.shared.errors import InputError
from tests.granular.linear.small_beds import D, at_rest, small_damper


@pytest.fixture(scope="module")
def rest() -> Equilibrium:
    return at_rest(small_damper())


@pytest.fixture(scope="module")
def light() -> Equilibrium:
    """Return a bed with a piston as light as a few grains, so that many modes contribute to its motion."""
    return at_rest(small_damper(**{"piston.mass": 0.004, "effects.drag.coefficient": 0.005}))


def test_eigenvalues_solve_the_linearised_equations_of_motion(rest: Equilibrium, light: Equilibrium) -> None:
    for one in (rest, light):
        for root in piston_roots(one):
            assert (
                np.abs(one.pencil.dynamic_stiffness_times(root.s, root.shape)).max() < 1e-9 * abs(root.s) ** 2
            )
            assert root.shape[one.pencil.bed.piston] == 1.0


def test_several_eigenvalues_contribute_to_the_motion_of_a_light_piston(light: Equilibrium) -> None:
    """Their residues agree with a solution for all eigenvalues."""
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
    # The response to a unit impulse on the piston is the sum of residues times exp(s t).
    residues = shapes[piston] * np.linalg.inv(shapes)[:, size + piston] * inverse[piston, piston]
    chosen = (roots.imag > 0.0) & (np.abs(residues) >= 0.05 * np.abs(residues).max())
    assert len(found) == chosen.sum() > 1
    for root in found:
        nearest = np.argmin(np.abs(roots - root.s))
        assert roots[nearest] == pytest.approx(root.s, rel=1e-8)
        assert residues[nearest] == pytest.approx(root.residue, rel=1e-6)
    fractions = 2.0 * pencil.mass[piston, piston] * np.real(roots * residues)
    assert fractions.sum() == pytest.approx(2.0, rel=1e-9)  # each root with its conjugate
    for root in found:
        assert root.mass_fraction == pytest.approx(fractions[np.argmin(np.abs(roots - root.s))], rel=1e-6)


@pytest.mark.parametrize("drag", [1.2, 10.0])
def test_an_overdamped_piston_is_refused(drag: float) -> None:
    """The piston has real eigenvalues, although surrounding grains oscillate."""
    heavy = at_rest(small_damper(**{"piston.mass": 0.02, "piston.drag": drag}))
    with pytest.raises(InputError, match=r"oscillations account for a fraction of \S+ of its motion"):
        piston_roots(heavy)


def test_an_unstable_equilibrium_is_refused() -> None:
    """One grain is vertically above another, so that any sideways displacement lowers the energy."""
    scene = small_damper(**{"grains.count": 2})
    width = scene.cell.width
    column = np.array([[0.5 * width, 2.0 * D], [0.5 * width, 4.0 * D]])
    saddle = equilibrium_from(scene, column, 6.0 * D)
    assert not saddle.is_stable
    with pytest.raises(InputError, match="not stable: an eigenvalue of the stiffness is -"):
        piston_roots(saddle)


def test_fractions_of_the_piston_motion_in_all_modes_add_up_to_one(rest: Equilibrium) -> None:
    modes = normal_modes(rest)
    piston = rest.pencil.bed.piston
    assert len(modes.frequencies) == 25
    assert (modes.shapes[piston] ** 2).sum() * 0.3 == pytest.approx(1.0, rel=1e-10)
    few = normal_modes(rest, 3)
    np.testing.assert_allclose(few.frequencies, modes.frequencies[:3], rtol=1e-10)


def test_static_stiffness_is_added_weight_divided_by_additional_sag(rest: Equilibrium) -> None:
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


SCENES: dict[str, dict[str, Any]] = {
    "damper": {"piston.drag": 0.3},
    "discs": {"grains.magnets": "cylinders"},
    "rows of touching discs": {
        "grains.magnets": "cylinders",
        "effects.walls": {
            side: {"law": "discs", "pitch": "6 mm"} for side in ("left", "right", "bottom", "top")
        },
    },
    "two species": {
        "grains.species": [
            {"name": "big", "diameter": "6 mm", "share": 0.6},
            {"name": "small", "diameter": "5 mm", "share": 0.4},
        ],
        "effects.walls": {"bottom": {"law": "slab"}, "top": {"law": "infinite"}},
    },
    "hard contact": {
        "grains.count": 24,
        "grains.remanence": 0.1,
        "piston.mass": 3.0,
        "piston.height": "8 D",
        "arrangement.height": "7.8 D",
        "effects.contact": {"modulus": 1e8},
    },
    "machine": {
        "effects.host": {
            "bodies": [
                {"mass": 0.5, "stiffness": 600.0, "damping": 0.4},
                {"mass": 0.4, "stiffness": 900.0, "damping": 0.3},
            ]
        }
    },
}
QUICK = ("damper",)
HARDER = {"hard contact": (2e8, 5e8, 1e9)}
"""Successive moduli [Pa]: the smallest overlap becomes 1e-3 D, three relative changes of a value."""


def logarithms(rest: Equilibrium) -> np.ndarray:
    root = piston_roots(rest)[0]
    assert rest.piston_height is not None
    return np.log([rest.piston_height, root.frequency, root.damping_ratio])


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.long) for name in SCENES]
)
def test_derivatives_of_eigenvalues_agree_with_differences_between_changed_scenes(name: str) -> None:
    rest = at_rest(small_damper(**SCENES[name]))
    for modulus in HARDER.get(name, ()):
        scene = rest.scene.replace(**{"effects.contact.modulus": modulus})
        rest = equilibrium_from(scene, rest.positions, rest.piston_height)
    found = slopes(rest)
    assert {"grains.remanence", "grains.density", "cell.width", "piston.mass"} <= set(found.keys)
    change, error = (1e-5, 5e-3) if name in HARDER else (1e-3, 1e-5)
    for key in found.keys:

        def changed(steps: int, key: str = key) -> np.ndarray:
            scene = scene_with_scaled_value(rest.scene, key, float(np.exp(steps * change)))
            return logarithms(equilibrium_from(scene, rest.positions, rest.piston_height))

        wanted = (8.0 * (changed(1) - changed(-1)) - (changed(2) - changed(-2))) / (12.0 * change)
        np.testing.assert_allclose(found.of(key), wanted, rtol=error, atol=error, err_msg=key)


def test_derivative_with_respect_to_a_value_that_is_not_a_number_is_refused() -> None:
    rest = at_rest(small_damper())
    with pytest.raises(InputError, match=r"'cell\.length' is not the key of a number"):
        slopes(rest, ["grains.remanence"]).of("cell.length")


def test_derivatives_exist_for_values_of_named_materials_but_not_for_temperatures() -> None:
    scene = small_damper(
        **{
            "grains.remanence": None,
            "grains.grade": "N45",
            "grains.temperature": 25.0,
            "effects.drag": {"liquid": "silicone oil 350 cSt"},
        }
    )
    found = keys_of_nonzero_numbers(scene)
    assert {"grains.remanence", "effects.drag.viscosity"} <= set(found)
    assert "grains.temperature" not in found
    at_bed = slopes(at_rest(scene))
    # Forces scale with the square of the remanence, the liquid's drag with the viscosity.
    assert at_bed.of("grains.remanence")[0] == pytest.approx(0.7, abs=0.1)
    assert at_bed.of("effects.drag.viscosity")[2] == pytest.approx(1.0, abs=0.05)
