"""The workshop sheet: its figures are those of the scene and of the settled bed."""

from __future__ import annotations

import functools
import math
import re
from typing import Any

import pytest

from granular import equilibrium, load_scene
from granular.linear import piston_roots
from granular.linear.equilibrium import Equilibrium, equilibrium_from
from granular.shared.errors import InputError
from reduced_models import DamperCandidate
from reduced_models.falls.workshop_sheet import slopes_by_part, workshop_sheet
from reduced_models.machines.design import DamperDesign
from reduced_models.machines.response import CoupledSystem, solve_host_response

COUNT = 92
"""Grains of beds that settle in a second."""


@functools.cache
def settled_bed() -> Equilibrium:
    return equilibrium(DamperCandidate(3.75, COUNT, 0.2).scene())


def bed(**changes: Any) -> Equilibrium:
    """Make the settled bed with other numbers, which has an equilibrium nearby."""
    rest = settled_bed()
    return equilibrium_from(rest.scene.replace(**changes), rest.positions, rest.piston_height)


def sheet_text(rest: Equilibrium) -> str:
    assert rest.piston_height is not None
    by_part = slopes_by_part(rest)
    page = workshop_sheet(rest.scene, rest.piston_height, by_part, title="sheet", lead="", scatter=["so far"])
    return page.to_html()


DRAG, MASS, REMANENCE = "effects.drag.coefficient", "piston.mass", "grains.remanence"


@pytest.mark.parametrize("drag", [0.2, 1.0])
def test_slopes_by_part_are_those_of_beds_with_other_parts(drag: float) -> None:
    """Also at strong damping, where a frequency divided by sqrt(1 - zeta^2) once more has other slopes."""
    found = slopes_by_part(bed(**{DRAG: drag}))
    parts = ((MASS, 3.75), (DRAG, drag), (REMANENCE, 1.3))
    for key, value in parts:
        high, low = (piston_roots(bed(**{DRAG: drag, key: x * value}))[0] for x in (1.001, 0.999))
        frequency = math.log(high.frequency / low.frequency) / 0.002
        damping = math.log(high.damping_ratio / low.damping_ratio) / 0.002
        assert found[key][1:] == pytest.approx([frequency, damping], rel=1e-3, abs=1e-5)


def test_a_bed_without_drag_has_no_line_for_it() -> None:
    assert DRAG not in slopes_by_part(bed(**{"effects.drag": None}))


def test_a_grade_changes_a_damper_as_its_remanence_does() -> None:
    rest = settled_bed()
    before, after = (piston_roots(bed(**{REMANENCE: b}))[0].frequency for b in (1.3, 1.345))
    text = sheet_text(rest)
    row = re.search(r"<td>N45</td><td>1.32 to 1.37</td><td>([-+.\d]+)</td>", text)
    assert row is not None
    assert float(row[1]) == pytest.approx(100.0 * (after / before - 1.0), abs=0.06)  # printed to 0.1
    assert "is none of them" not in text
    odd = bed(**{"grains.species.0.diameter": "5.95 mm"})
    assert "5.95 x 3 is none of them" in sheet_text(odd)


def test_the_sheet_names_parts_and_command() -> None:
    small = {"name": "small", "diameter": "5.95 mm", "share": 0.3}
    rest = bed(**{"grains.species": [{"name": "large", "diameter": "6 mm", "share": 0.7}, small]})
    scene = rest.scene
    text = sheet_text(rest)
    masses = scene.grains.masses()
    assert f"{1e3 * masses.min():.3g} g each" in text
    assert f"{1e3 * masses.max():.3g} g each" in text
    assert "granular-damper calibrate lab.csv scene.toml" in text
    assert "@media print" in text


def test_a_design_for_a_machine_has_a_sheet() -> None:
    machine = load_scene("machine")
    law = solve_host_response(CoupledSystem.from_host_scene(machine), [2.8], 10.0)
    scene = machine.replace(
        **{"grains.count": 48, "cell.width": "22 D", "piston.mass": 2.7, "effects.drag.coefficient": 0.5}
    )
    text = DamperDesign(scene, law, 24e-3, 1e-3, 9e-3, 7.7, "").workshop_sheet_page().to_html()
    assert "how far starts differ is not known" in text
    assert "remanence of the discs" in text


def test_a_piston_that_does_not_oscillate_has_no_costs() -> None:
    with pytest.raises(InputError, match="no oscillation about its equilibrium"):
        slopes_by_part(bed(**{DRAG: 50.0}))
