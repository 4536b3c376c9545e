"""Scene keys for liquids, piston blade, piston guide and walls of discs."""

import math
from typing import Any

import numpy as np
import pytest

from granular import Scene, equilibrium, evaluate, load_scene, scene_text
from granular.effects.wall_discs import tabulate_disc_wall
from granular.linear import motion_friction
from granular.pairs.disc_law import Disc
from granular.parts.liquids import find_liquid
from granular.shared.errors import InputError
from tests.modes import quick_in_plain_python

LIQUID = "effects.drag.liquid"


def damper(**changes: object) -> Scene:
    return load_scene("damper").replace(**changes)


def test_digests_of_scenes_without_commercial_parts_are_unchanged_since_earlier_versions() -> None:
    """Stored runs are found by these digests."""
    digests = {name: load_scene(name).digest() for name in ("bed", "damper")}
    assert digests == {"bed": "a2363bd9bb9ea27b", "damper": "be80f988c909b380"}


def test_drag_of_a_disc_in_a_named_liquid_agrees_with_hand_calculation() -> None:
    scene = damper(
        **{LIQUID: "silicone oil 350 cSt", "grains.temperature": 35.0, "cell.separation": "3.4 mm"}
    )
    ratio = 10.0 ** (763.1 * (1.0 / 308.15 - 1.0 / 298.15))
    viscosity = 350e-6 * ratio * 970.0 / (1.0 + 9.5e-4 * 10.0)
    area = math.pi / 4.0 * 0.006**2
    assert scene.effects.drag is not None
    assert scene.effects.drag.coefficient == pytest.approx(2.0 * viscosity * area / 0.2e-3, rel=1e-9)
    shifted = scene.replace(**{"effects.drag.offset": "0.1 mm", "effects.drag.packing": 0.4}).effects.drag
    assert shifted is not None
    films = 1.0 / 0.1e-3 + 1.0 / 0.3e-3
    back = 1.0 + 3.0 * 0.4 / 0.6 * 0.0064**2 / 0.0034**3 / films
    assert shifted.coefficient == pytest.approx(viscosity * area * films * back, rel=1e-9)


def test_drag_on_piston_blade_and_guide_agrees_with_hand_calculation() -> None:
    scene = damper(
        **{
            "effects.drag.viscosity": 0.1,
            "piston.blade": {"depth": "10 mm", "film": "0.05 mm"},
            "piston.guide": {"diameter": "12 mm", "length": "30 mm", "clearance": "50 um", "count": 2},
        }
    )
    assert scene.piston is not None
    blade = 2.0 * 0.1 * 0.36 * 0.01 / 5e-5
    guide = 2.0 * math.pi * 0.1 * 0.03 / math.log(6.05 / 6.0)
    assert scene.piston.drag == pytest.approx(blade + 2.0 * guide, rel=1e-9)
    words = scene_text(scene)
    assert f"blade {blade:.5g} kg/s" in words
    assert f"in all {scene.piston.drag:.5g} kg/s" in words
    assert Scene.from_plain(scene.to_plain()) == scene


def test_setting_a_drag_coefficient_or_viscosity_removes_the_keys_that_it_replaces() -> None:
    oil = damper(
        **{
            LIQUID: "silicone oil 350 cSt",
            "piston.guide": dict.fromkeys(("diameter", "length"), 0.01) | {"clearance": 1e-4},
        }
    )
    assert "coefficient" not in oil.to_plain()["effects"]["drag"]
    measured = oil.replace(**{"effects.drag.coefficient": 0.2})  # the liquid still sets the guide's drag
    assert measured.effects.drag is not None
    assert measured.piston is not None
    assert oil.piston is not None
    assert (measured.effects.drag.coefficient, measured.piston.drag) == (0.2, oil.piston.drag)
    assert Scene.from_plain(measured.to_plain()) == measured
    changes: dict[str, Any] = {LIQUID: None, "effects.drag.coefficient": 0.2, "piston.drag": 1.0}
    assert oil.replace(**changes).to_plain() == damper(**changes).to_plain()
    thick = oil.replace(**{"effects.drag.viscosity": 0.5}).effects.drag
    assert thick is not None
    assert (thick.liquid, thick.viscosity) == (None, 0.5)
    cold = oil.replace(**{"grains.temperature": 5.0}).effects.drag
    assert cold is not None
    assert cold.viscosity == find_liquid("silicone oil 350 cSt", 5.0).viscosity


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({LIQUID: "honey"}, "effects.drag.liquid: unknown liquid"),
        ({LIQUID: "water", "effects.drag.viscosity": 0.1}, "effects.drag: .* not both"),
        ({LIQUID: "air", "cell.separation": "3 mm"}, "cell.separation: .* no space for liquid films"),
        ({"piston.blade": {"depth": 0.01, "film": 1e-4}}, "piston.blade: requires a liquid"),
        (
            {"effects.drag.viscosity": 0.1, "piston.blade": {"depth": 0.01, "film": "1.6 mm"}},
            "piston.blade.film: .* cell.separation, 0.00155 m",
        ),
        (
            {"piston.guide": {"diameter": 0.01, "length": 0.01, "clearance": 1e-4}},
            "piston.guide.liquid: is missing",
        ),
        ({"effects.drag.offset": 1e-5}, "effects.drag: .* give liquid or viscosity"),
    ],
)
def test_inconsistent_scene_keys_for_a_liquid_are_an_error(changes: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        damper(**changes)


def laws(scene: Scene) -> list[str]:
    assert scene.effects.walls is not None
    return [wall.law for _, wall in scene.effects.walls.sides_with_walls]


def test_default_walls_of_a_bed_of_discs_are_rows_of_the_same_magnets() -> None:
    assert laws(load_scene("magnets")) == ["discs"] * 4
    assert laws(load_scene("damper")) == ["experimental"] * 4
    discs = damper(**{"grains.magnets": "cylinders", "grains.species.0.diameter": "5 mm"})
    assert discs.effects.walls is not None
    assert [wall.pitch for _, wall in discs.effects.walls.sides_with_walls] == [0.005] * 4
    assert discs.replace(**{"grains.magnets": "dipoles", "grains.species.0.diameter": "6 mm"}) == damper()


def test_walls_given_explicitly_are_kept_for_a_bed_of_discs() -> None:
    before = damper().to_plain() | {"name": "saved"}
    before["grains"]["magnets"] = "cylinders"
    saved = Scene.from_plain(before)  # as stored with an older run
    assert laws(saved) == ["experimental"] * 4
    assert laws(saved.replace(**{"grains.remanence": 1.2})) == ["experimental"] * 4
    mixed = load_scene("magnets").replace(
        **{"effects.walls.left": "none", "effects.walls.right.law": "infinite"}
    )
    assert laws(mixed) == ["infinite", "discs", "discs"]
    wide = load_scene("magnets").replace(**{"effects.walls.left.pitch": "7 mm"}).effects.walls
    assert wide is not None
    assert [wall.pitch for _, wall in wide.sides_with_walls] == [0.007, 0.006, 0.006, 0.006]


@quick_in_plain_python
def test_wall_of_coated_discs_repels_like_rows_of_their_cores() -> None:
    """The magnetic cores begin half a coated diameter behind the wall's face."""
    coat = 0.1  # fraction of the diameter, exaggerated
    scene = load_scene("magnets").replace(
        **{
            "grains.count": 1,
            "grains.coating": f"{coat} D",
            "effects.gravity": None,
            "effects.drag": None,
            "arrangement": {"positions": [[0.18, 0.009]]},
        }
    )
    from granular.effects.wall_discs import disc_row_energy_and_forces
    from granular.schema import Scales

    scales, core = Scales.from_grains(scene.grains), Disc(0.5 - coat, 0.5 - 2.0 * coat)
    tables = tabulate_disc_wall((core,), core, 1.0, 1.0, 0.5)
    below = disc_row_energy_and_forces(tables, 0, 1.5, 30.0)[1]
    above = disc_row_energy_and_forces(tables, 0, 18.5, 30.0)[1]
    found = evaluate(scene, np.array([[0.18, 0.009]]), np.zeros((1, 2)), 0.12).force[0, 1]
    assert found == pytest.approx((below - above) * scales.force, rel=1e-9)
    magnet = 1.3 * math.pi / 4.0 * (0.8 * 0.006) ** 2 * 0.0018 / (4e-7 * math.pi)
    assert scales.current * scales.length**2 == pytest.approx(magnet, rel=1e-9)


def test_packaged_scene_workshop_contains_the_drag_and_magnets_of_its_parts() -> None:
    scene = load_scene("workshop")
    assert scene.effects.drag is not None
    assert scene.effects.walls is not None
    assert [wall.law for _, wall in scene.effects.walls.sides_with_walls] == ["discs"] * 4
    viscosity, film = 350e-6 * 970.0, 0.05e-3
    drag = 2.0 * viscosity * math.pi / 4.0 * 0.006**2 / film
    assert scene.effects.drag.coefficient == pytest.approx(drag, rel=1e-9)
    words = scene_text(scene)
    assert "N42 has 1.28 to 1.32 T" in words
    assert "core of 5.97 x 2.97 mm" in words


@pytest.mark.long
def test_packaged_scene_workshop_settles_and_its_friction_is_the_sum_of_plate_and_guide_friction() -> None:
    """At an amplitude of one diameter the oil dissipates more than the plates."""
    rest = equilibrium(load_scene("workshop"))
    assert rest.is_stable
    assert rest.frictionless
    rubs = motion_friction(rest)
    assert rubs.moving_load < rubs.load
    assert rubs.force == pytest.approx(0.04 * rubs.moving_load + 0.05, rel=1e-12)
    # At an amplitude of one diameter, oil dissipates more than the plates.
    assert rubs.drag_amplitude < 0.006
