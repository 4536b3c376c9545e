"""Responses to sines of stepped frequency, compared with closed forms, and their command."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import load_scene, simulate
from granular.__main__ import main
from granular.effects.host_structure import Host
from granular.response.linear_system import (
    dynamic_stiffness_of_hanging_mass,
    linear_response,
    tuned_mass_spring_and_dashpot,
)
from granular.response.response import (
    fit_complex_amplitude,
    frequency_response,
    measure_steady_amplitudes_and_energies,
)
from granular.scene.scene import Scene
from granular.shared.errors import InputError

BODY = {"mass": 2.0, "stiffness": 800.0, "damping": 6.0}
RESONANCE = math.sqrt(800.0 / 2.0) / math.tau
RATIOS = (0.3, 0.95, 1.05, 3.0)


def bench(**changes: Any) -> Scene:
    """Return a machine with a linear tuned mass, which is one grain on a spring with drag."""
    mass = 0.2
    plain = {
        "name": "bench",
        "grains": {
            "count": 1,
            "species": [{"diameter": "6 mm"}],
            "density": mass / (math.pi / 4.0 * 0.006**2 * 0.003),
        },
        "cell": {"width": "60 D"},
        "effects": {
            "walls": {
                "left": "none",
                "right": "none",
                "top": "none",
                "bottom": {"energy": "k*(w-l)^2/2", "k": "75 N/m", "l": "60 mm"},
            },
            "drag": {"coefficient": 1.0},
            "host": {"bodies": [BODY], "excitation": {"force": 1.0, "frequency": 3.0}},
        },
        "arrangement": {"positions": [["0.1 m", "60 mm"]]},
        "protocol": [{"name": "shake", "kind": "hold", "duration": 20.0}],
        "piston": {"height": "20 D"},
        "output": {"scalars": "2 ms", "frames": "1 s"},
    }
    return Scene.from_plain(plain).replace(**changes)


@pytest.mark.long
def test_frequency_response_agrees_with_a_linear_two_degree_of_freedom_system(tmp_path: Path) -> None:
    scene, frequencies = bench(), [ratio * RESONANCE for ratio in RATIOS]
    found = frequency_response(scene, frequencies, duration=12.0, out=tmp_path, workers=1, progress=False)
    hung = dynamic_stiffness_of_hanging_mass(frequencies, 0.2, 75.0, 1.0)
    host = scene.effects.host
    assert host is not None
    exact = np.abs(linear_response(host, frequencies, hung)[:, -1])
    data = found.dataset.isel(amplitude=0)
    np.testing.assert_allclose(data.displacement, exact, rtol=5e-3)
    omega = math.tau * np.array(frequencies)
    np.testing.assert_allclose(data.added_damping, hung.imag / omega, rtol=0.05, atol=0.02)
    np.testing.assert_allclose(data.effective_mass, -hung.real / omega**2, rtol=0.05, atol=0.02)
    again = frequency_response(scene, frequencies, duration=12.0, out=tmp_path, workers=1, progress=False)
    assert found.dataset.equals(again.dataset)


@pytest.mark.parametrize("ratio", [0.02, 0.05, 0.2])
def test_tuned_mass_with_den_hartogs_parameters_gives_two_equal_peaks(ratio: float) -> None:
    host = Host.from_plain(
        {"bodies": [{"mass": 100.0, "stiffness": 4e4}], "excitation": {"force": 1.0, "frequency": 1.0}}
    )
    frequencies = np.linspace(1.5, 5.0, 8001)
    mass = 100.0 * ratio
    hung = dynamic_stiffness_of_hanging_mass(frequencies, mass, *tuned_mass_spring_and_dashpot(host, mass))
    swing = np.abs(linear_response(host, frequencies, hung)[:, 0])
    peaks = np.flatnonzero((swing[1:-1] > swing[:-2]) & (swing[1:-1] > swing[2:]))
    assert len(peaks) == 2
    # sqrt(1 + 2/mu) times the static deflection at the fixed points, which the peaks exceed to second order
    best = math.sqrt(1.0 + 2.0 / ratio) / 4e4
    np.testing.assert_allclose(swing[1:-1][peaks], best, rtol=0.005)


def test_complex_amplitude_of_an_oscillation_is_recovered_despite_a_drift() -> None:
    time = np.linspace(0.0, 3.7, 900)
    values = 2.0 * np.sin(math.tau * 2.0 * time + 0.7) + 5.0 - 0.1 * time
    found = fit_complex_amplitude(time, values, 2.0)
    assert abs(found) == pytest.approx(2.0, rel=1e-2)
    assert np.angle(found) == pytest.approx(0.7, abs=1e-2)


@pytest.mark.long  # the quick tests check energy ledgers of random machines in plain Python
def test_work_of_the_force_per_period_equals_the_drag_loss() -> None:
    run = simulate(bench(), t_end=10.0, progress=False)
    figures = measure_steady_amplitudes_and_energies(run)
    taken = figures["drag_loss_a_period"] + figures["host_loss_a_period"]
    assert figures["work_a_period"] == pytest.approx(taken, rel=0.01)
    swing = complex(figures["real"], figures["imaginary"])
    assert figures["work_a_period"] == pytest.approx(-math.pi * swing.imag, rel=0.01)


@pytest.mark.long
def test_command_response_prints_the_response_and_refuses_invalid_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "bench.toml"
    bench().save(file)
    words = (
        f"response {file} --from 2Hz --to 4Hz --points 2 --duration 6 --force 2N --workers 1 --json --quiet"
    )
    main([*words.split(), "--workers", "1", "-o", str(tmp_path / "out")])
    answer = json.loads(capsys.readouterr().out)
    assert answer["peaks"][0]["amplitude"] == 2.0
    assert (tmp_path / "out" / "response.png").is_file()
    assert len((tmp_path / "out" / "response.csv").read_text().splitlines()) == 3
    with pytest.raises(InputError, match="no host under a sine"):
        frequency_response(load_scene("bed"), [1.0])
    with pytest.raises(InputError, match="2 points or more"):
        main(["response", str(file), "--from", "4Hz", "--to", "2Hz"])
