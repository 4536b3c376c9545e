"""The workshop sheet for building a damper agrees with its scene and with the settled bed."""

import dataclasses
import functools
import math
import re
from typing import Any

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from granular import Scene, equilibrium, load_scene
from granular.linear import motion_friction, piston_roots
from granular.linear.equilibrium import Equilibrium, equilibrium_from
from granular.shared.errors import InputError
from reduced_models import DamperCandidate
from reduced_models.falls.workshop import usual_tolerances, workshop_sheet
from reduced_models.machines.design import DamperDesign
from reduced_models.machines.response import CoupledSystem, solve_host_response

AMPLITUDE = 1.2e-3
COUNT = 92
"""Number of grains of beds that settle within a second."""


@functools.cache
def settled_bed() -> Equilibrium:
    return equilibrium(DamperCandidate(3.75, COUNT, 0.2).scene())


def bed(**changes: Any) -> Equilibrium:
    """Return a settled bed with changed parameters, and its equilibrium."""
    rest = settled_bed()
    return equilibrium_from(rest.scene.replace(**changes), rest.positions, rest.piston_height)


def sheet_text(rest: Equilibrium) -> str:
    assert rest.piston_height is not None
    words: dict[str, Any] = {"title": "sheet", "lead": "", "scatter": ["so far"]}
    page = workshop_sheet(rest.scene, rest.piston_height, lambda: rest, amplitude=AMPLITUDE, **words)
    return page.to_html()


def number(pattern: str, text: str) -> float:
    found = re.search(pattern.replace("#", r"([-+.\de]+)"), text)
    assert found is not None, (pattern, text)
    return float(found[1])


def rows_of(text: str, section: str) -> list[list[str]]:
    """Return the cells of the first table after a heading."""
    table = text.split(f"<h2>{section}</h2>")[1].split("</table>", maxsplit=1)[0]
    return [re.findall("<td[^>]*>(.*?)</td>", row) for row in table.split("<tr>")[2:]]


def scene_of_parts(text: str) -> Scene:
    """Return a scene built only from the sheet's list of parts, under gravity."""
    rows = rows_of(text, "Parts")
    (piston, plates, liquid), discs = (
        [next(row for row in rows if row[0].startswith(name)) for name in ("piston", "plates", "liquid")],
        [row for row in rows if row[0].startswith("disc magnet,")],
    )
    total, species = sum(int(row[1]) for row in discs), []
    for k, (_, count, size, mass) in enumerate(discs):
        diameter, thickness = (1e-3 * number(f"{word} # mm", size) for word in ("diameter", "thickness"))
        known = {"name": f"disc {k}", "diameter": diameter, "share": int(count) / total}
        density = 1e-3 * number("# g each", mass) / (math.pi / 4.0 * diameter**2 * thickness)
        known |= {"thickness": thickness, "remanence": number("remanence # T", size), "density": density}
        species.append(known)
    walls: dict[str, Any] = {}
    sides = {"left side": "left", "right side": "right", "floor": "bottom", "piston": "top"}
    for name, _, size, _ in (row for row in rows if row[0].startswith("disc magnets of")):
        law = re.search("law ([a-z]+)", size)
        pitch = 1e-3 * number("pitch # mm", size)
        walls[sides[name[20:]]] = {"law": law[1]} if law else {"law": "discs", "pitch": pitch}
    height = 1e-3 * number("height # mm", plates[2])
    magnets = "cylinders" if "simulated as discs" in discs[0][2] else "dipoles"
    drag, mass = number("drag # kg/s", piston[2]), number("# kg", piston[3])
    liquid_drag = {"coefficient": number("drag of a disc # kg/s", liquid[2])}
    return Scene.from_plain(
        {
            "name": "built",
            "grains": {"count": total, "species": species, "magnets": magnets},
            "cell": {"width": 1e-3 * number("inner width # mm", plates[2])},
            "piston": {"height": height, "mass": mass, "drag": drag},
            "effects": {"dipole": {}, "walls": walls, "gravity": {}, "drag": liquid_drag},
            "arrangement": {"height": height - 0.006, "speed": 0.0},
            "protocol": [{"name": "drop", "kind": "free", "until": "rest"}],
            "output": {"scalars": 1e-3, "frames": 0.1},
        }
    )


def check_parts(rest: Equilibrium) -> None:
    """Assert that the list of parts gives the same damper."""
    built = equilibrium_from(scene_of_parts(sheet_text(rest)), rest.positions, rest.piston_height)
    assert built.piston_height == pytest.approx(rest.piston_height, rel=0.01)
    found, wanted = piston_roots(built)[0], piston_roots(rest)[0]
    assert found.frequency == pytest.approx(wanted.frequency, rel=0.01)
    assert found.damping_ratio == pytest.approx(wanted.damping_ratio, rel=0.03)


def test_list_of_parts_on_the_workshop_sheet_reproduces_the_damper() -> None:
    check_parts(bed(**{"piston.drag": 0.7}))


@pytest.mark.long
def test_list_of_parts_on_the_workshop_sheet_reproduces_a_damper_with_two_grain_sizes() -> None:
    check_parts(equilibrium(DamperCandidate(3.0, COUNT, 0.4, small_share=0.3).scene()))


def test_workshop_sheet_lists_gaps_that_keep_the_bed_plane_and_notes_if_friction_doubles_damping() -> None:
    rest = settled_bed()
    ratio, count = piston_roots(rest)[0].damping_ratio, len(rest.positions)
    thickness = float(rest.scene.grains.species_values("thickness").max())
    nearest = pdist(rest.positions).min()
    rows = rows_of(sheet_text(rest), "Liquid and gap")
    assert [row[0] for row in rows] == ["0.05", "0.1", "0.2"]
    for row in rows:
        play = 2e-3 * float(row[0])
        assert 7.5 * (play / nearest) ** 2 < 0.05
        depth = dataclasses.replace(rest, scene=rest.scene.replace(**{"cell.separation": thickness + play}))
        for words, static in zip(row[5].split(". "), (0.05, 0.1), strict=True):
            rubs = motion_friction(depth, static)
            doubles = rubs.equivalent_damping_ratio(AMPLITUDE) > ratio
            assert ("doubles the damping" in words) == doubles
            assert number("below # mm", words) == pytest.approx(1e3 * rubs.sticking_amplitude, rel=0.05)
        assert float(row[4]) == pytest.approx(rubs.load / count, rel=0.05)


def test_piston_height_of_the_first_contact_on_the_workshop_sheet_agrees_with_the_compressed_bed() -> None:
    rest = settled_bed()
    down = 1e-3 * number("touch # mm below rest", sheet_text(rest))
    assert rest.piston_height is not None
    squeezed = rest.positions * [1.0, 1.0 - down / rest.piston_height]
    i, j = np.triu_indices(COUNT, 1)
    assert np.hypot(*(squeezed[i] - squeezed[j]).T).min() == pytest.approx(0.006, rel=1e-3)


def test_workshop_sheet_names_the_wall_law_and_the_mass_to_weigh() -> None:
    text = sheet_text(settled_bed())
    assert "law experimental in place of these rows" in text
    assert "First weigh the piston" in text
    assert "--parameter piston.mass" not in text


DRAG, MASS, REMANENCE = "effects.drag.coefficient", "piston.mass", "grains.remanence"


@pytest.mark.parametrize("drag", [0.2, 1.0])
def test_sensitivities_on_the_workshop_sheet_agree_with_eigenvalues_for_changed_parts(drag: float) -> None:
    """With strong damping, natural and damped frequency have different sensitivities."""
    rest = bed(**{DRAG: drag})
    found, root = usual_tolerances(rest, AMPLITUDE), piston_roots(rest)[0]
    slopes = dict(zip([part.key for part in found.parts], found.slopes[0], strict=True))
    for part in (one for one in found.parts if one.key in (MASS, DRAG, REMANENCE)):
        off = part.deviation / part.value
        values = [part.value * (1.0 + sign * off) for sign in (1.0, -1.0)]
        high, low = (piston_roots(bed(**{DRAG: drag, part.key: value}))[0] for value in values)
        frequency = (high.frequency - low.frequency) / root.frequency / (2.0 * off)
        damping = (high.damping_ratio - low.damping_ratio) / root.damping_ratio / (2.0 * off)
        assert slopes[part.key][1:] == pytest.approx([frequency, damping], rel=1e-3, abs=1e-5)


@pytest.mark.long
def test_workshop_sheet_shows_the_effect_of_tolerances_including_friction() -> None:
    """Friction is evaluated at the amplitude of use. A bed without drag has no line for drag."""
    rows = {row[0]: row for row in rows_of(sheet_text(settled_bed()), "Tolerances of the parts")}
    wanted = usual_tolerances(settled_bed(), AMPLITUDE)
    for part, own in zip(wanted.parts, wanted.contributions, strict=True):
        assert rows[part.key][5:] == [f"{100.0 * value:.3f}" for value in own]
    rubbing = bed(**{"effects.drag": None, "effects.friction": {"static": 0.02, "dynamic": 0.015}})
    found = usual_tolerances(rubbing, AMPLITUDE)
    assert DRAG not in [part.key for part in found.parts]
    assert found.amplitude == AMPLITUDE
    # Friction on side walls does not enter the damping ratio.
    assert usual_tolerances(bed(**{"effects.wall_friction.coefficient": 0.1}), AMPLITUDE).amplitude is None


def test_effect_of_a_magnet_grade_on_the_workshop_sheet_equals_the_effect_of_its_remanence() -> None:
    rest = settled_bed()
    before, after = (piston_roots(bed(**{REMANENCE: b}))[0].frequency for b in (1.3, 1.345))
    text = sheet_text(rest)
    row = re.search(r"<td>N45</td><td[^>]*>1.32 to 1.37</td><td[^>]*>([-+.\d]+)</td>", text)
    assert float(row[1]) == pytest.approx(100.0 * (after / before - 1.0), abs=0.06)  # printed to 0.1
    assert "is not available" not in text
    odd = bed(**{"grains.species.0.diameter": "5.95 mm"})
    assert "5.95 x 3 is not available" in sheet_text(odd)


def test_workshop_sheet_lists_the_masses_of_parts_and_the_command_for_calibration() -> None:
    small = {"name": "small", "diameter": "5.95 mm", "share": 0.3}
    rest = bed(**{"grains.species": [{"name": "large", "diameter": "6 mm", "share": 0.7}, small]})
    scene = rest.scene
    text = sheet_text(rest)
    masses = scene.grains.masses()
    assert f"{1e3 * masses.min():.4g} g each" in text
    assert f"{1e3 * masses.max():.4g} g each" in text
    assert "granular-damper calibrate lab.csv scene.toml" in text
    assert "@media print" in text


def test_a_design_for_a_machine_has_a_workshop_sheet() -> None:
    machine = load_scene("machine")
    law = solve_host_response(CoupledSystem.from_host_scene(machine), [2.8], 10.0)
    scene = machine.replace(
        **{"grains.count": 48, "cell.width": "22 D", "piston.mass": 2.7, "effects.drag.coefficient": 0.5}
    )
    text = DamperDesign(scene, law, 24e-3, 1e-3, 9e-3, 7.7, "").workshop_sheet_page().to_html()
    assert "The spread over packings is unknown" in text
    assert "grains.remanence" in text


def test_workshop_sheet_of_a_bed_without_an_equilibrium_contains_a_note() -> None:
    def refuse() -> Equilibrium:
        raise InputError("no equilibrium is near")

    words: dict[str, Any] = {"title": "sheet", "lead": "", "scatter": ["so far"]}
    text = workshop_sheet(settled_bed().scene, 0.06, refuse, amplitude=AMPLITUDE, **words).to_html()
    assert "no equilibrium is near" in text
    assert "Tolerances of the parts" not in text


def test_workshop_sheet_of_an_overdamped_piston_omits_the_effect_of_tolerances() -> None:
    text = sheet_text(bed(**{DRAG: 50.0}))
    assert "reduce the drag" in text
    assert "Tolerances of the parts" not in text
