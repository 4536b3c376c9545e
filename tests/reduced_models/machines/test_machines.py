"""The law at work on a host: its equation, its limits, and designs from it."""

from __future__ import annotations

import math

import numpy as np
import pytest
import sympy

from granular import load_scene
from granular.effects.excitation import Excitation
from granular.effects.host_structure import Host
from granular.shared.errors import InputError
from reduced_models.falls.predicted_law import OutsideRangeWarning
from reduced_models.laws.annealing_bed import ANNEALING_BED
from reduced_models.machines import design_for, predicted_response
from reduced_models.machines.design import DamperDesign, _frequencies_near_peak, _outside_range_text
from reduced_models.machines.response import CoupledSystem, PredictedResponse, fill_rates, solve_host_response

FREQUENCIES = np.linspace(2.6, 3.2, 13).tolist()


def test_the_equation_is_that_of_the_law_where_the_bed_weighs_nothing() -> None:
    law = CoupledSystem.from_host_scene(load_scene("machine"))
    law = law._replace(bed=0.0, moving=law.piston, host=1e30)
    state = np.array([0.0, 0.0, 0.055, -0.2, 0.02, 0.6])
    rates = np.zeros(6)
    fill_rates(law, 0.0, state, rates)
    numbers = {
        "lam": law.drag / (2.0 * law.piston),
        "weight": law.gravity,
        "rest": law.rest,
        "power": 2.5,
        "modulus": law.modulus,
        "strength": law.strength,
        "z": 0.055,
        "z_first": -0.2,
        "w": 0.02,
        "q": 0.6,
    }
    parsed = ANNEALING_BED.parsed_equation
    values = [parsed.acceleration, parsed.hidden["w"], parsed.hidden["q"]]
    exact = [float(one.subs({s: numbers[_name(s)] for s in one.free_symbols})) for one in values]
    np.testing.assert_allclose(rates[3:], exact, rtol=1e-9)


def _name(symbol: sympy.Symbol) -> str:
    parsed = ANNEALING_BED.parsed_equation
    return {parsed.symbol_z: "z", parsed.symbol_v: "z_first"}.get(symbol, symbol.name)


def test_small_swings_are_linear() -> None:
    law = CoupledSystem.from_host_scene(load_scene("machine"))._replace(modulus=1e-9)
    found = solve_host_response(law, FREQUENCIES, 0.01)
    np.testing.assert_allclose(found.displacement, found.linear, rtol=0.03)


def test_outside_of_what_was_measured_a_user_is_warned() -> None:
    scene = load_scene("machine")
    assert not predicted_response(scene, FREQUENCIES).outside
    with pytest.warns(OutsideRangeWarning, match=r"0.5 to 2 D"):
        assert predicted_response(scene, FREQUENCIES, 40.0).outside
    with pytest.raises(InputError, match="no host of one body"):
        predicted_response(load_scene("damper"), FREQUENCIES)


@pytest.mark.long
def test_a_design_beats_the_packaged_damper_and_says_no() -> None:
    scene = load_scene("machine")
    host = scene.effects.host
    assert host is not None
    assert host.excitation is not None
    found = design_for(host, host.excitation, limit=7.75)
    assert found.is_worthwhile
    assert found.mass <= 7.75
    packaged = predicted_response(scene, FREQUENCIES).peak
    assert found.ideal < found.peak < 0.8 * packaged
    body = host.bodies[0]
    assert found.alone == pytest.approx(
        10.0 / (body.damping * math.sqrt(body.stiffness / body.mass)), rel=1e-2
    )
    stiff = Host.from_plain({"bodies": [{"mass": "100 kg", "stiffness": "4 MN/m", "damping": 4e3}]})
    with pytest.warns(OutsideRangeWarning):
        no = design_for(stiff, Excitation(force=10.0, frequency=30.0), limit=7.75, simulate=False)
    assert not no.is_worthwhile
    assert no.verdict.startswith("no: ")
    with pytest.warns(OutsideRangeWarning, match="it expects"):
        less = design_for(host, Excitation(force=0.5, frequency=3.0), limit=7.75, simulate=False)
    assert less.peak < 0.5 * less.alone
    assert less.is_worthwhile
    assert less.verdict.endswith("in which it was compared with simulations: simulate it")


def test_discs_are_stiffer_and_a_design_is_made_of_them() -> None:
    host = load_scene("machine").effects.host
    assert host is not None
    assert host.excitation is not None
    found = design_for(host, host.excitation, limit=4.0, magnets="cylinders", simulate=False)
    assert found.scene.grains.magnets == "cylinders"
    assert found.is_worthwhile
    of_dipoles = found.scene.replace(**{"grains.magnets": "dipoles"})
    discs, dipoles = (CoupledSystem.from_host_scene(scene) for scene in (found.scene, of_dipoles))
    assert discs.rest > dipoles.rest
    # Stiffer by more than the higher bed is softer, but between rows of discs.
    walls = of_dipoles.effects.walls
    assert walls is not None
    named = CoupledSystem.from_host_scene(found.scene.replace(**{"effects.walls": walls.to_plain()}))
    assert named.power > dipoles.power == 2.5
    assert named.small_swing.omega > dipoles.small_swing.omega > discs.small_swing.omega


@pytest.mark.parametrize(
    ("peak", "stroke", "words"),
    [
        (6.0e-4, 0.1, "less than the 0.5 to 2 D"),
        (6.0e-4, 1.0, "take away 94 % of the peak"),
        (6.0e-4, 3.0, "more than the 0.5 to 2 D"),
        (9.9e-3, 0.1, "less than the 0.5 to 2 D"),
        (9.9e-3, 1.0, "leaves most"),
        (math.nan, math.nan, "leaves most"),
    ],
)
def test_a_verdict_says_what_its_figures_say(peak: float, stroke: float, words: str) -> None:
    """Of 9.95 mm; a bed that takes most of it away damps, however little it moves."""
    curve = np.array([peak, 0.5 * peak])
    law = PredictedResponse(np.array([3.0, 3.5]), curve, curve, curve, False)
    outside = _outside_range_text(stroke)
    found = DamperDesign(load_scene("machine"), law, 9.95e-3, 5e-4, 6e-3 * stroke, 7.75, outside)
    assert words in found.verdict
    assert found.verdict.startswith("no: ") == (not peak < 1e-3) == (not found.is_worthwhile)


def test_the_peak_is_simulated_where_the_law_has_it() -> None:
    law = solve_host_response(CoupledSystem.from_host_scene(load_scene("machine")), FREQUENCIES, 10.0)
    near = _frequencies_near_peak(law)
    peak = FREQUENCIES[int(law.displacement.argmax())]
    assert near[0] < peak < near[-1]
    assert np.diff(near).max() < 0.05 * peak
