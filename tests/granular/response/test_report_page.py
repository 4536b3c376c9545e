"""Report page of a frequency response, its stored file, and errors of its commands, without simulations."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import Scene, load_scene
from granular.effects.host_structure import Host
from granular.response import load_response, save_response
from granular.response.linear_system import (
    dynamic_stiffness_of_hanging_mass,
    host_amplitudes_and_damper_equivalents,
    linear_response,
    slowest_decay_rate,
)
from granular.response.report_page import energy_losses_per_period, response_page, unsteadiness_warnings
from granular.response.response import FrequencyResponse, response_dataset
from granular.response.transients import relative_sweep_rate_at_peak
from granular.shared.errors import InputError

FREQUENCIES = np.linspace(2.5, 3.6, 9).tolist()
HUNG = (7.0, 2500.0, 90.0)
"""Mass, spring and dashpot of the linear stand-in for a damper."""


def made(scene: Scene, forces: tuple[float, ...] = (5.0, 10.0), **settings: Any) -> FrequencyResponse:
    """Return a response of the scene's machine with a linear damper, in place of a simulation."""
    host = scene.effects.host
    assert host is not None
    hung = dynamic_stiffness_of_hanging_mass(FREQUENCIES, *HUNG)
    swing = np.array([linear_response(host, FREQUENCIES, hung)[:, -1] * f / 10.0 for f in forces])
    still = np.full(swing.shape, 0.01)
    found = {
        "displacement": ("m", "amplitude", np.abs(swing)),
        "phase": ("rad", "phase", -np.angle(swing)),
        "unsteady": ("1", "change", 7.0 * still),
        "work_a_period": ("J", "work", 3.0 * still),
        "drag_loss_a_period": ("J", "drag", 2.0 * still),
        "affine_loss_a_period": ("J", "drag", 1.5 * still),
        "friction_loss_a_period": ("J", "friction", 0.0 * still),
        "host_loss_a_period": ("J", "dashpots", 1.0 * still),
    }
    found |= host_amplitudes_and_damper_equivalents(scene, host, "force", forces, FREQUENCIES, swing)
    return FrequencyResponse(scene, response_dataset("force", forces, FREQUENCIES, found), settings)


def test_page_of_a_frequency_response_shows_peaks_energy_losses_and_deviations_from_periodicity() -> None:
    found = made(load_scene("machine"), dt="auto*4", duration=12.0)
    data = found.dataset
    np.testing.assert_allclose(data.added_damping[0], data.added_damping[1], rtol=1e-9)
    hung = dynamic_stiffness_of_hanging_mass(FREQUENCIES, *HUNG)
    omega = math.tau * np.array(FREQUENCIES)
    np.testing.assert_allclose(data.added_damping[0], hung.imag / omega, rtol=1e-9)
    page = response_page(found, missing="nothing is known").to_html()
    row = found.peaks()[1]
    assert f"{row['reduction']:.3g} times as much" in page
    for words in (
        "times lower",
        "rearranging [mJ]",
        "added damping",
        "loss factor",
        "auto*4",
        "changes by 7 % during the measurement",
        "stiffness = 41700",
        "nothing is known",
    ):
        assert words in page, words
    assert "friction [mJ]" not in page


def test_rearrangement_loss_is_the_drag_loss_minus_the_loss_by_affine_motion() -> None:
    losses = energy_losses_per_period(made(load_scene("machine")).dataset.isel(amplitude=0))
    assert set(losses) == {"affine drag", "rearranging", "dashpots"}
    np.testing.assert_allclose(losses["rearranging"], 0.005)


def test_a_saved_frequency_response_is_read_exactly(tmp_path: Path) -> None:
    found = made(load_scene("machine"), dt="auto", duration=12.0)
    save_response(found, tmp_path)
    again = load_response(tmp_path)
    assert again.dataset.equals(found.dataset)
    assert again.scene == found.scene
    assert again.settings == found.settings
    with pytest.raises(InputError, match=r"has no response\.json; create it"):
        load_response(tmp_path / "nothing")
    for text in ("{", "[]", '{"scene": {}, "settings": {}, "dataset": {}}'):
        (tmp_path / "response.json").write_text(text)
        with pytest.raises(InputError, match=r"cannot be read: .* create it again"):
            load_response(tmp_path)


def test_a_frequency_sweep_that_is_too_fast_causes_a_note() -> None:
    slow, fast = (
        made(load_scene("machine"), (10.0,), dt="auto", duration=length, sweep=[2.5, 3.6])
        for length in (4000.0, 4.0)
    )
    paces = relative_sweep_rate_at_peak(slow), relative_sweep_rate_at_peak(fast)
    assert paces[0] is not None
    assert paces[1] == pytest.approx(1000.0 * paces[0])
    for found, told in ((fast, True), (slow, False)):
        assert any("too fast" in note.words for note in unsteadiness_warnings(found)) == told


def test_decay_rate_of_a_single_mass_equals_damping_over_twice_the_mass() -> None:
    body = {"mass": 2.0, "stiffness": 800.0, "damping": 6.0}
    assert slowest_decay_rate(Host.from_plain({"bodies": [body]})) == pytest.approx(1.5)
    stiff = {"mass": 0.01, "stiffness": 1e6, "damping": 100.0}
    rate = slowest_decay_rate(Host.from_plain({"bodies": [body, stiff]}))
    assert rate == pytest.approx(6.0 / 4.02, rel=1e-3)


SWEEP = ("response", "machine", "--from", "2Hz", "--to", "4Hz", "--sweep")
STRUCK = ("response", "--impulse")
REFUSED = [
    ((*SWEEP, "0s"), "a sweep of 0 s is shorter than 12 periods of its lowest frequency"),
    ((*SWEEP, "60s", "--workers", "2"), "--workers cannot be combined with --sweep"),
    ((*SWEEP, "60s", "--force", "0N"), "the force of the host's drive is 0"),
    (
        ("response", "machine", "--from", "4Hz", "--to", "2Hz", "--sweep", "60s"),
        "--from must be above 0 and below --to",
    ),
    (("response", "bed", "--from", "2Hz", "--to", "4Hz", "--sweep", "60s"), "has no host"),
    (
        (
            "response",
            "machine",
            "--from",
            "2Hz",
            "--to",
            "4Hz",
            "--sweep",
            "60s",
            "--set",
            "effects.host.excitation=none",
        ),
        "add --force, --acceleration or --displacement",
    ),
    (("response", "machine", "--to", "4Hz"), "required: --from; see "),
    ((*SWEEP, "60s", "--fraction", "0.1"), "--fraction cannot be combined with sines"),
    ((*STRUCK, "machine"), "required: --force"),
    ((*STRUCK, "machine", "--force", "5N", "--force", "9N"), "an impulse has one"),
    ((*STRUCK, "machine", "--force", "5N", "--sweep", "9s"), "--sweep cannot be combined with --impulse"),
    ((*STRUCK, "machine", "--force", "5N", "--from", "2Hz"), "--from cannot be combined with --impulse"),
    ((*STRUCK, "bed", "--force", "5N"), "has no host with bodies"),
    ((*STRUCK, "machine", "--force", "0N"), "a finite force that is not 0"),
    ((*STRUCK, "machine", "--force", "5N", "--fraction", "1.5"), "above 0 and below 1"),
    ((*STRUCK, "machine", "--force", "5N", "--length", "12s"), "the run must last longer than the impulse"),
]


@pytest.mark.parametrize(("words", "message"), REFUSED)
def test_invalid_input_of_the_command_response_gives_a_one_line_error(
    words: tuple[str, ...], message: str, command: Callable[..., Any]
) -> None:
    done = command("granular", *words)
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.splitlines()) == 1
