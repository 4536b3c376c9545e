"""The bed law coupled to a machine: its equation, its limits, designs, and comparison with simulated
responses.
"""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import Scene, load_scene
from granular.effects.excitation import HostExcitation
from granular.effects.host_structure import Host
from granular.response import save_response
from granular.response.response import FrequencyResponse, response_dataset
from granular.shared.errors import InputError
from reduced_models.falls.predicted_law import OutsideRangeWarning
from reduced_models.laws.annealing_bed import ANNEALING_BED
from reduced_models.laws.equation import compile_rates
from reduced_models.machines import compare_response, design_for, predicted_response
from reduced_models.machines.design import DamperDesign, _frequencies_near_peak, _outside_range_text
from reduced_models.machines.response import (
    CoupledSystem,
    PredictedResponse,
    fill_state_rates,
    solve_host_response,
)

FREQUENCIES = np.linspace(2.6, 3.2, 13).tolist()


def test_equation_of_a_machine_with_a_bed_reduces_to_the_bed_law_for_massless_grains() -> None:
    law = CoupledSystem.from_host_scene(load_scene("machine"))
    law = law._replace(bed=0.0, moving=law.piston, host=1e30)
    state, rates = np.array([0.0, 0.0, 0.055, -0.2, 0.02, 0.6]), np.zeros(6)
    fill_state_rates(law, 0.0, state, rates)
    values = {"lam": law.drag / (2.0 * law.piston), "weight": law.gravity, "rest": law.rest, "power": 2.5}
    values |= {"modulus": law.modulus, "strength": law.strength}
    field = compile_rates(ANNEALING_BED.equation, (), "numpy")
    exact = field(*state[2:], *(values[name] for name in ANNEALING_BED.parameters))
    np.testing.assert_allclose(rates[3:], exact, rtol=1e-9)


def test_small_oscillations_of_a_machine_with_a_bed_are_linear() -> None:
    law = CoupledSystem.from_host_scene(load_scene("machine"))._replace(modulus=1e-9)
    found = solve_host_response(law, FREQUENCIES, 0.01)
    np.testing.assert_allclose(found.displacement, found.linear, rtol=0.03)


def test_law_of_a_machine_with_a_bed_warns_outside_the_tested_range() -> None:
    scene = load_scene("machine")
    assert not predicted_response(scene, FREQUENCIES).outside
    with pytest.warns(OutsideRangeWarning, match=r"0.5 to 2 D"):
        assert predicted_response(scene, FREQUENCIES, 40.0).outside
    with pytest.raises(InputError, match="needs a host with a single body"):
        predicted_response(load_scene("damper"), FREQUENCIES)


@pytest.mark.long
def test_a_design_for_a_machine_is_better_than_the_packaged_damper_or_reports_that_none_helps() -> None:
    scene = load_scene("machine")
    host = scene.effects.host
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
        no = design_for(stiff, HostExcitation(force=10.0, frequency=30.0), limit=7.75, simulate=False)
    assert not no.is_worthwhile
    assert no.verdict.startswith("no damper is worthwhile: ")
    with pytest.warns(OutsideRangeWarning, match="it predicts"):
        less = design_for(host, HostExcitation(force=0.5, frequency=3.0), limit=7.75, simulate=False)
    assert less.peak < 0.5 * less.alone
    assert less.is_worthwhile
    assert less.verdict.endswith("for which it was compared with simulations: simulate it")


def test_a_bed_of_discs_on_a_machine_is_stiffer_and_can_be_designed() -> None:
    host = load_scene("machine").effects.host
    assert host.excitation is not None
    found = design_for(host, host.excitation, limit=4.0, magnets="cylinders", simulate=False)
    assert found.scene.grains.magnets == "cylinders"
    assert found.is_worthwhile
    of_dipoles = found.scene.replace(**{"grains.magnets": "dipoles"})
    discs, dipoles = (CoupledSystem.from_host_scene(scene) for scene in (found.scene, of_dipoles))
    assert discs.rest > dipoles.rest
    # The discs' stiffening exceeds the softening by the higher bed, but not between rows of discs.
    walls = of_dipoles.effects.walls
    named = CoupledSystem.from_host_scene(found.scene.replace(**{"effects.walls": walls.to_plain()}))
    assert named.power > dipoles.power == 2.5
    assert named.small_oscillation.omega > dipoles.small_oscillation.omega > discs.small_oscillation.omega


@pytest.mark.parametrize(
    ("peak", "stroke", "words"),
    [
        (6.0e-4, 0.1, "less than the 0.5 to 2 D"),
        (6.0e-4, 1.0, "reduce the peak by 94 %"),
        (6.0e-4, 3.0, "more than the 0.5 to 2 D"),
        (9.9e-3, 0.1, "less than the 0.5 to 2 D"),
        (9.9e-3, 1.0, "hardly reduces"),
        (math.nan, math.nan, "hardly reduces"),
    ],
)
def test_printed_assessment_of_a_damper_agrees_with_its_peaks(peak: float, stroke: float, words: str) -> None:
    """The peak without a damper is 9.95 mm. A damper is not rejected merely because the bed moves little."""
    curve = np.array([peak, 0.5 * peak])
    law = PredictedResponse(np.array([3.0, 3.5]), curve, curve, curve, False)
    outside = _outside_range_text(stroke)
    found = DamperDesign(load_scene("machine"), law, 9.95e-3, 5e-4, 6e-3 * stroke, 7.75, outside)
    assert words in found.verdict
    refused = found.verdict.startswith("no damper is worthwhile: ")
    assert refused == (not peak < 1e-3) == (not found.is_worthwhile)


def test_simulated_frequencies_include_the_peak_predicted_by_the_law() -> None:
    law = solve_host_response(CoupledSystem.from_host_scene(load_scene("machine")), FREQUENCIES, 10.0)
    near = _frequencies_near_peak(law)
    peak = FREQUENCIES[int(law.displacement.argmax())]
    assert near[0] < peak < near[-1]
    assert np.diff(near).max() < 0.05 * peak


RESPONSE_FREQUENCIES = [2.7, 2.85, 3.0]


def made(scene: Scene, key: str = "force") -> FrequencyResponse:
    """Return a response with a peak of 4 mm."""
    swing = np.array([[1e-3, 4e-3, 2e-3]])
    data = response_dataset(key, [10.0], RESPONSE_FREQUENCIES, {"displacement": ("m", "amplitude", swing)})
    return FrequencyResponse(scene, data)


def test_reported_errors_are_relative_errors_of_the_peaks() -> None:
    found = compare_response(made(load_scene("machine")))
    (peak,) = found.peaks
    said = predicted_response(load_scene("machine"), found.frequencies.tolist(), 10.0)
    assert peak.law == said.peak
    assert peak.law_peak_error == pytest.approx(said.peak / 4e-3 - 1.0)
    assert peak.linear == said.linear.max()
    assert found.frequencies[[0, -1]].tolist() == [2.7, 3.0]
    with pytest.raises(InputError, match="base of the machine is shaken"):
        compare_response(made(load_scene("machine"), "acceleration"))


def test_the_command_shows_the_law_or_the_reason_for_its_absence(
    tmp_path: Path, command: Callable[..., Any]
) -> None:
    save_response(made(load_scene("machine")), tmp_path)
    done = command("reduced_models", "compare", "--response", str(tmp_path))
    assert done.returncode == 0
    assert done.stdout.startswith("force [N]  simulated [mm]  law [mm]  error")
    page = (tmp_path / "report.html").read_text()
    assert "The law in place of the bed" in page
    assert "linear law" in page
    save_response(made(load_scene("machine").replace(**{"grains.count": 92})), tmp_path)
    done = command("reduced_models", "compare", "--response", str(tmp_path), "--json")
    answer = json.loads(done.stdout)
    assert answer["peaks"] == []
    assert "92 grains" in answer["missing"]
    assert "92 grains" in (tmp_path / "report.html").read_text()
    done = command("reduced_models", "compare", "--response", str(tmp_path / "nothing"))
    assert done.returncode == 2
    assert "has no response.json" in done.stderr
