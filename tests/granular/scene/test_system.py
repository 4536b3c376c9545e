"""Natural units of scenes, unequal grains, and rescaling of dampers with equal dimensionless groups."""

import math
from typing import Any

import numpy as np
import pytest

from granular import Scene, evaluate, load_scene, scene_text
from granular.linear import piston_roots
from granular.linear.equilibrium import equilibrium_from
from granular.methods import METHODS
from granular.observables.moduli import crystal_moduli, dipole_pair_strength
from granular.scene.scene_in_natural_units import (
    FAR_EVERY,
    dimensionless_groups,
    dimensionless_groups_text,
    lattice_rest_height,
    rescale_scene_to_width,
    scene_in_natural_units,
)
from granular.schema.natural_units import MAGNETIC_CONSTANT, Scales
from granular.shared.errors import InputError
from tests.granular.linear.small_beds import at_rest, small_damper


def every(scene: Scene, wanted: int | None, method: str = "stormer-verlet") -> int | None:
    """Return the number of steps between long-range impulses in a scene with the mesh sum."""
    pairs: dict[str, object] = {"method": "mesh"}
    if wanted is not None:
        pairs["far_every"] = wanted
    system = scene_in_natural_units(scene.replace(pairs=pairs), method=METHODS[method])
    far = system.constants.acting.far
    assert far is not None
    return far.every


def test_interval_of_long_range_impulses_is_set_by_the_key_far_every(small_bed: Scene) -> None:
    free = small_bed.replace(**{"effects.friction": None})
    assert every(free, None) == FAR_EVERY
    assert every(free, 4) == 4
    assert every(free, 1) is None  # a part of every force


def test_direct_sum_is_split_into_short_and_long_range_parts_if_far_every_is_given(small_bed: Scene) -> None:
    def far_every(scene: Scene, method: str = "stormer-verlet") -> int | None:
        far = scene_in_natural_units(scene, method=METHODS[method]).constants.acting.far
        return None if far is None else far.every

    free = small_bed.replace(**{"effects.friction": None})
    asked = free.replace(**{"pairs.far_every": 8})
    assert far_every(free) is None
    assert far_every(asked) == 8
    assert far_every(asked.replace(**{"pairs.method": "direct"})) == 8
    assert far_every(free.replace(**{"pairs.far_every": 1})) is None
    with pytest.raises(InputError, match="'pefrl' does not support it"):
        far_every(asked, "pefrl")


def test_methods_without_long_range_impulses_include_the_long_range_part_in_every_force(
    small_bed: Scene,
) -> None:
    free = small_bed.replace(**{"effects.friction": None})
    assert every(free, None, "pefrl") is None
    assert every(free, 1, "pefrl") is None
    with pytest.raises(InputError, match="'pefrl' does not support it"):
        every(free, 2, "pefrl")


MU0 = 4e-7 * math.pi


def mixed(**changes: Any) -> Scene:
    """Return a bed with friction, of big grains and of small ones with another remanence, density and
    thickness.
    """
    small = {"name": "small", "diameter": "4 mm", "share": 0.4, "remanence": "0.9 T"}
    return load_scene("bed").replace(
        **{
            "grains.count": 23,
            "grains.species": [
                {"name": "big", "diameter": "6 mm", "share": 0.6},
                small | {"density": 5000.0, "thickness": "2.9 mm"},
            ],
            "cell.width": "15 D",
            "piston.height": "8 D",
            "arrangement.height": "7 D",
            "effects.drag": None,
            "effects.friction": True,
            "effects.walls": dict.fromkeys(("left", "right", "bottom", "top"), "infinite"),
        }
        | changes
    )


def test_material_values_given_for_a_species_give_the_same_forces_as_equal_values_for_all_grains() -> None:
    scene = load_scene("bed").replace(**{"grains.count": 9})
    place = scene.initial_positions_and_velocities()[0]
    told = scene.replace(
        **{
            "grains.species.0.remanence": scene.grains.remanence,
            "grains.species.0.density": scene.grains.density,
            "grains.species.0.thickness": scene.grains.thickness,
        }
    )
    np.testing.assert_array_equal(evaluate(told, place).force, evaluate(scene, place).force)


def test_masses_and_magnetic_moments_follow_from_the_material() -> None:
    grains = mixed().grains
    sheet = math.pi / 4.0 * 0.004**2 * 0.0029
    assert grains.masses()[grains.species_indices() == 1] == pytest.approx(5000.0 * sheet, rel=1e-14)
    integer = math.pi / 4.0 * 0.006**2 * 0.003
    assert grains.moment_ratios()[1] == pytest.approx(0.9 * sheet / (1.3 * integer), rel=1e-14)
    spread = mixed(
        **{
            "grains.spread": 0.1,
            "grains.count": 400,
            "cell.width": "60 D",
            "piston.height": "40 D",
            "arrangement.height": "39 D",
        }
    )
    factors = spread.grains.moment_spread_factors()
    assert factors.std() == pytest.approx(0.1, rel=0.1)
    assert np.abs(factors - 1.0).max() <= 0.3 + 1e-15


@pytest.mark.parametrize(
    "changes",
    [{}, pytest.param({"grains.magnets": "cylinders", "effects.walls": True}, marks=pytest.mark.long)],
)
def test_rescaled_beds_have_equal_dimensionless_groups_and_results(changes: dict[str, Any]) -> None:
    """The results are equilibrium height over width W, frequency times sqrt(W/g), and damping ratio."""
    rest = at_rest(small_damper(**changes))
    width, root = rest.scene.cell.width, piston_roots(rest)[0]
    assert rest.piston_height is not None
    expected = rest.piston_height / width, root.frequency * math.sqrt(width / 9.8), root.damping_ratio
    for factor in (0.1, 0.5, 1.7, 2.0, 10.0):
        scene = rescale_scene_to_width(rest.scene, factor * width)
        assert scene.cell.width == pytest.approx(factor * width, rel=1e-12)
        assert dimensionless_groups(scene) == pytest.approx(dimensionless_groups(rest.scene), rel=1e-12)
        there = equilibrium_from(scene, factor * rest.positions, factor * rest.piston_height)
        found, size = piston_roots(there)[0], factor * width
        assert there.piston_height is not None
        figures = there.piston_height / size, found.frequency * math.sqrt(size / 9.8), found.damping_ratio
        assert figures == pytest.approx(expected, rel=1e-9)


def test_dimensionless_groups_agree_with_their_definitions() -> None:
    """For the packaged damper, kappa = mu0 m^2/(pi M g W^4) with m = Br V/mu0."""
    volume = math.pi / 4.0 * 6e-3**2 * 3e-3
    mu0 = 4e-7 * math.pi
    kappa = mu0 * (1.3 * volume / mu0) ** 2 / (math.pi * 7.5 * 9.8 * 0.36**4)
    groups = dimensionless_groups(load_scene("damper"))
    assert groups["kappa"] == pytest.approx(kappa, rel=1e-12)
    assert groups["N m/M"] == pytest.approx(368 * 7368.0 * volume / 7.5, rel=1e-12)
    assert groups["gamma sqrt(W/g)/M"] == pytest.approx(0.1 * math.sqrt(0.36 / 9.8) / 7.5, rel=1e-12)
    assert (
        "kappa 2.495e-09"
        in dimensionless_groups_text(load_scene("damper"))
        in scene_text(load_scene("damper"))
    )
    assert dimensionless_groups(load_scene("bed")) == {}


def test_pressure_of_the_crystal_at_the_estimated_equilibrium_height_carries_the_piston() -> None:
    """The pressure times the width equals the weight of the piston."""
    scene = load_scene("damper")
    groups, width = dimensionless_groups(scene), scene.cell.width
    rest = lattice_rest_height(368, width, groups["kappa"])
    strength = dipole_pair_strength(scene.grains.magnets_in_species()[0].moment)
    pressure = crystal_moduli(368 / (width * rest), strength).pressure
    assert pressure * width == pytest.approx(7.5 * 9.8, rel=1e-6)  # of the lattice sum


def test_commercial_parts_and_the_machine_are_rescaled_with_the_scene() -> None:
    """A liquid is replaced by a drag coefficient.

    Magnetic moments are proportional to the cube of the size, and stiffnesses of springs to the size.
    """
    oil = load_scene("damper").replace(
        **{"effects.drag.liquid": "silicone oil 100 cSt", "grains.moment": 0.0877, "cell.separation": "4 mm"}
    )
    half = rescale_scene_to_width(oil, 0.5 * oil.cell.width)
    assert half.effects.drag is not None
    assert oil.effects.drag is not None
    assert half.effects.drag.liquid is None
    assert half.effects.drag.coefficient == pytest.approx(oil.effects.drag.coefficient * 0.5**1.5)
    assert half.grains.moment == pytest.approx(0.0877 / 8.0)
    assert dimensionless_groups(half) == pytest.approx(dimensionless_groups(oil))
    machine = load_scene("machine")
    host = rescale_scene_to_width(machine, 4.0 * machine.cell.width).effects.host
    assert host is not None
    assert host.excitation is not None
    body = host.bodies[0]
    assert (body.mass, body.stiffness, body.damping) == pytest.approx((1600.0, 4 * 41.7e3, 8 * 20.4))
    assert host.excitation.frequency == pytest.approx(3.25 / 2.0)
    with pytest.raises(InputError, match="custom parts"):
        rescale_scene_to_width(
            load_scene("bed").replace(**{"effects.field": [{"energy": "f*y", "f": "1 mN"}]}), 1.0
        )


def test_masses_moments_and_natural_units_agree_with_published_tables() -> None:
    """The tables are 2.1 and 4.3 in de Paula's thesis [D]."""
    expected = {
        0.006: (6.2498e-4, 0.08775, 2.37656, 1.25612e-3, 2.57715e-3, 4.1303),
        0.005: (4.3401e-4, 0.0609375, 2.37656, 9.5557e-4, 1.78969e-3, 4.5245),
        0.008: (1.11107e-3, 0.156, 2.37656, 1.93393e-3, 4.5816e-3, 3.5769),
    }
    bed = load_scene("bed")
    for diameter, (mass, moment, force, tau, gravity, balance) in expected.items():
        scene = bed.replace(
            **{
                "grains.species.0.diameter": diameter,
                "cell.width": 0.9,
                "piston.height": 0.3,
                "arrangement.height": 0.28,
            }
        )
        scales = Scales.from_grains(scene.grains)
        weight = 9.8 / scales.acceleration
        volume = math.pi * 0.003 * diameter**2 / 4.0
        assert scales.mass == pytest.approx(mass, rel=5e-5)
        assert 1.3 * volume / MAGNETIC_CONSTANT == pytest.approx(moment, rel=5e-5)
        assert scales.force == pytest.approx(force, rel=5e-6)
        assert scales.time == pytest.approx(tau, rel=5e-6)
        assert weight == pytest.approx(gravity, rel=5e-5)
        assert (0.75 / weight) ** 0.25 == pytest.approx(balance, rel=5e-5)
