"""The workshop sheet: its figures are those of the scene and of the law."""

from __future__ import annotations

import math
import re

import pytest

from granular import damper, load_scene
from granular.shared.errors import InputError
from reduced_models import DamperCandidate, predict
from reduced_models.falls.workshop_sheet import (
    silicone_oil_viscosity_ratio,
    swing_sensitivities,
    workshop_sheet,
)
from reduced_models.machines.design import DamperDesign
from reduced_models.machines.response import CoupledSystem, solve_host_response


def test_sensitivities_are_those_of_a_heavier_piston() -> None:
    told = swing_sensitivities(damper())["mass of the piston"]
    before, after = (predict(damper(mass)).at_rest for mass in (7.5, 7.5 * 1.01))
    assert before is not None
    assert after is not None
    assert math.log(after.damping_ratio / before.damping_ratio) / math.log(1.01) == pytest.approx(
        told[1], rel=0.02
    )


def test_a_weaker_bed_and_a_heavier_piston_change_the_rest_alike() -> None:
    """A bed that follows at once: the height of rest goes with remanence^0.8, f with -0.4."""
    told = swing_sensitivities(damper(drag=1e-4))
    assert told["remanence of the discs"][0] == pytest.approx(-0.4, abs=0.01)
    assert told["drag of a disc"][1] == pytest.approx(1.0, abs=0.01)
    assert "drag of a disc" not in swing_sensitivities(damper().replace(**{"effects.drag": None}))


def test_viscosity_falls_as_measured() -> None:
    """Polisil P10 has 3.73 Pa s at -25 degrees and 1.18 Pa s at 25 (Monteiro et al., J. Plastination)."""
    assert silicone_oil_viscosity_ratio(25.0) == 1.0
    assert silicone_oil_viscosity_ratio(-25.0) == pytest.approx(3.73 / 1.18, rel=0.05)


def test_a_grade_changes_a_damper_as_its_remanence_does() -> None:
    scene = damper().replace(**{"grains.remanence": 1.3})
    before, after = (predict(scene.replace(**{"grains.remanence": b})).at_rest for b in (1.3, 1.465))
    assert before is not None
    assert after is not None
    frequency = 100.0 * (before.period / after.period - 1.0)
    text = workshop_sheet(scene, 0.06, title="sheet", lead="", scatter=["so far"]).to_html()
    row = re.search(r"<td>N52</td><td>1.45 to 1.48</td><td>([-+.\d]+)</td>", text)
    assert row is not None
    assert float(row[1]) == pytest.approx(frequency, abs=0.1)
    assert "is none of them" not in text
    assert (
        "5.5 x 3 is none of them"
        in workshop_sheet(
            scene.replace(**{"grains.species.0.diameter": "5.5 mm"}), 0.06, title="", lead="", scatter=[]
        ).to_html()
    )


def test_the_sheet_names_parts_and_command() -> None:
    scene = DamperCandidate(4.0, 200, 0.2, small_share=0.3).scene()
    text = workshop_sheet(scene, 0.06, title="sheet", lead="", scatter=["so far"]).to_html()
    masses = scene.grains.masses()
    assert f"{1e3 * masses.min():.3g} g each" in text
    assert f"{1e3 * masses.max():.3g} g each" in text
    assert "granular-damper calibrate lab.csv scene.toml" in text
    assert "@media print" in text


def test_a_design_for_a_machine_has_a_sheet() -> None:
    scene = load_scene("machine")
    law = solve_host_response(CoupledSystem.from_host_scene(scene), [2.8], 10.0)
    text = DamperDesign(scene, law, 24e-3, 1e-3, 9e-3, 7.7, "").workshop_sheet_page().to_html()
    assert "how far starts differ is not known" in text
    assert "remanence of the discs" in text


def test_a_piston_that_does_not_swing_has_no_sensitivities() -> None:
    with pytest.raises(InputError, match="no swing about rest"):
        swing_sensitivities(damper(drag=50.0))
