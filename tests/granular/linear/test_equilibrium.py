"""Equilibria of small beds, and scenes for which no equilibrium can be found."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from granular import equilibrium, evaluate, load_scene, simulate
from granular.linear import normal_modes, piston_roots
from granular.linear import pencil as pencils
from granular.linear.equilibrium import (
    COARSE_REST,
    _find_equilibrium_pencil_by_newton,
    equilibrium_from,
    scene_changes_to_end_at_rest,
)
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError
from tests.granular.linear.small_beds import D, at_rest, moved, small_damper
from tests.granular.pairs.test_periodic import crystal
from tests.modes import quick_in_plain_python

MASS, GRAVITY = 0.05, 9.8


@quick_in_plain_python
def test_a_grain_between_walls_behaves_as_a_mass_on_two_springs() -> None:
    infinite = {side: {"law": "infinite"} for side in ("left", "right", "bottom", "top")}
    scene = small_damper(
        **{
            "grains.count": 1,
            "piston.mass": MASS,
            "piston.drag": 0.02,
            "effects.walls": infinite,
            "arrangement": {"positions": [[0.04, 0.015]]},
        }
    )
    rest = at_rest(scene)
    grain, force = float(scene.grains.masses()[0]), Scales.from_grains(scene.grains).force
    # F (D/w)^3 on either side; the piston's weight on one side, and the grain's weight on the other.
    weights = np.array([MASS, MASS + grain]) * GRAVITY
    over, under = D * (force / weights) ** (1.0 / 3.0)
    np.testing.assert_allclose(rest.positions, [[0.5 * scene.cell.width, under]], rtol=1e-11)
    assert rest.piston_height == pytest.approx(over + under, rel=1e-11)
    upper, lower = 3.0 * weights / [over, under]
    matrices = [
        np.array([[upper + lower, -upper], [-upper, upper]]) / [[grain], [MASS]],
        np.diag([scene.effects.drag.coefficient / grain, 0.02 / MASS]),
    ]
    rates = np.block([[np.zeros((2, 2)), np.eye(2)], [-matrices[0], -matrices[1]]])
    wanted = np.linalg.eigvals(rates)
    for root in piston_roots(rest):
        assert np.abs(wanted - root.s).min() < 1e-8 * abs(root.s)


def test_forces_vanish_at_the_equilibrium() -> None:
    rest = at_rest(small_damper())
    found = evaluate(rest.scene, rest.positions, None, rest.piston_height)
    assert rest.is_stable
    assert not rest.frictionless
    assert np.abs(found.force).max() < 1e-12
    assert found.piston_force == pytest.approx(0.3 * GRAVITY, rel=1e-12)


def test_dry_friction_does_not_change_the_equilibrium() -> None:
    rest = at_rest(small_damper())
    rubbed = moved(rest, **{"effects.drag": None, "effects.friction": True, "piston.friction": 0.1})
    found = equilibrium_from(rubbed, rest.positions + 1e-4 * D, rest.piston_height)
    assert found.frictionless
    np.testing.assert_allclose(found.positions, rest.positions, atol=1e-10)
    assert found.piston_height == pytest.approx(rest.piston_height, rel=1e-9)


@pytest.mark.long  # compiles a mesh
def test_crystal_in_a_periodic_cell_has_two_zero_frequency_modes(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = crystal(10, 12, **{"pairs.method": "mesh", "arrangement.jitter": 0.02})
    rest = equilibrium_from(scene, scene.initial_positions_and_velocities()[0], None)
    assert rest.is_stable
    squares = normal_modes(rest).squared_angular_frequencies
    # The force error of the mesh gives the shifts a small stiffness.
    assert (np.abs(squares[:2]) < 3e-4 * squares[-1]).all()
    assert squares[2] > 3e-3 * squares[-1]
    mode = normal_modes(rest).shapes[:, 5]
    falling = rest.pencil.full_stiffness - 1.1 * squares[5] * np.outer(
        rest.pencil.mass @ mode, rest.pencil.mass @ mode
    )
    pencil = dataclasses.replace(rest.pencil)
    vars(pencil)["full_stiffness"] = falling
    assert not dataclasses.replace(rest, pencil=pencil).is_stable
    monkeypatch.setattr(pencils, "DENSE", 0)
    large = equilibrium_from(scene, rest.positions, None)
    assert large.is_stable
    np.testing.assert_allclose(large.lowest_stiffness, rest.lowest_stiffness, rtol=1e-4)
    low = normal_modes(large, 5).squared_angular_frequencies
    np.testing.assert_allclose(low[2:], squares[2:5], rtol=1e-5)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"pairs": {"method": "cut-off"}},
            "'cut-off' cuts off pair forces at a distance at which they are not zero",
        ),
        ({"pairs": {"method": "verlet-list"}}, "'verlet-list' cuts off pair forces"),
    ],
)
def test_equilibrium_with_a_cut_off_at_which_the_force_jumps_is_refused(
    changes: dict[str, object], words: str
) -> None:
    scene = small_damper(**changes)
    with pytest.raises(InputError, match=words):
        equilibrium_from(scene, scene.initial_positions_and_velocities()[0], 0.03)


def test_equilibrium_with_pair_sums_over_nearest_images_is_refused() -> None:
    scene = crystal(4, 4)
    with pytest.raises(InputError, match="use 'mesh'"):
        equilibrium_from(scene, scene.initial_positions_and_velocities()[0], None)


def test_equilibrium_of_a_scene_without_grains_or_without_a_stage_that_ends_at_rest_is_refused() -> None:
    with pytest.raises(InputError, match=r"choose grains\.count"):
        equilibrium(small_damper(**{"grains.count": 0}))
    with pytest.raises(InputError, match="add until = 'rest'"):
        equilibrium(small_damper(**{"protocol": [{"name": "r", "kind": "hold", "duration": 1.0}]}))


@pytest.mark.long  # the quick tests check other sources without a settled bed
def test_equilibrium_of_a_bed_without_a_floor_is_refused() -> None:
    scene = small_damper(**{"effects.walls": {"bottom": "none"}})
    with pytest.raises(InputError, match="start from a run that has come to rest"):
        equilibrium_from(scene, scene.initial_positions_and_velocities()[0], 0.03)


def test_a_bed_under_a_held_piston_has_modes_but_no_piston_roots() -> None:
    rest = at_rest(
        small_damper(**{"piston.mass": None, "protocol": [{"name": "r", "kind": "hold", "duration": 1.0}]})
    )
    assert rest.piston_height == 0.03
    assert rest.pencil.bed.piston is None
    assert len(normal_modes(rest).frequencies) == 24
    with pytest.raises(InputError, match=r"give piston\.mass and effects\.walls\.top"):
        piston_roots(rest)


def test_newton_iteration_stops_if_an_equilibrium_has_just_vanished(monkeypatch: pytest.MonkeyPatch) -> None:
    """The force -(q^2 + 1e-8) has its smallest magnitude at q = 0, but never vanishes."""

    def matrices(at: np.ndarray) -> SimpleNamespace:
        made.append(at)
        return SimpleNamespace(solve=lambda s, force, held: force / (2.0 * at[0]))

    bed: Any = SimpleNamespace(
        size=1, length=1.0, weight=0.0, scales=SimpleNamespace(force=1.0), forces=lambda at: -(at**2 + 1e-8)
    )
    made: list[np.ndarray] = []
    monkeypatch.setattr("granular.linear.equilibrium.make_pencil", lambda bed, at: matrices(at))
    start = np.array([1e-2])
    first: Any = matrices(start)
    with pytest.raises(
        InputError, match=r"no equilibrium was found near the start: forces of 1\.?\d*e-08 N remain"
    ):
        _find_equilibrium_pencil_by_newton(bed, start, (), first, fresh=True)
    assert len(made) <= 8


@pytest.mark.long
def test_a_bed_with_a_soft_mode_is_relaxed_until_the_newton_iteration_converges() -> None:
    changes = {"grains.remanence": 1.025 * 1.3, "arrangement.seed": 210}
    scene = load_scene("damper").replace(**changes)
    rest = equilibrium(
        simulate(scene.replace(**scene_changes_to_end_at_rest(scene, COARSE_REST)), progress=False)
    )
    assert rest.is_stable
    assert rest.lowest_stiffness[0] < 0.01  # [N/m]; the next one is 0.7
    assert rest.residual < 1e-9
