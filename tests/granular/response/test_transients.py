"""Responses to an impulse and to a frequency sweep, compared with a linear oscillator."""

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.signal import lsim

from granular import Scene
from granular.__main__ import main
from granular.response import settling_time, swept_response
from granular.response.response import swept_amplitudes
from granular.response.transients import settling_time_of_samples
from granular.run.trajectory import Trajectory
from granular.shared.errors import InputError

MASS, STIFFNESS, DAMPING = 2.0, 800.0, 8.0
BODY = {"mass": MASS, "stiffness": STIFFNESS, "damping": DAMPING}


def amplitude(frequency: np.ndarray) -> np.ndarray:
    """Return the complex amplitude [m] of the oscillator for a force amplitude of 1 N."""
    omega = math.tau * frequency
    return np.asarray(1.0 / (STIFFNESS - MASS * omega**2 + 1j * omega * DAMPING))


def machine(excitation: dict[str, object], duration: float) -> Scene:
    return Scene.from_plain(
        {
            "name": "bare",
            "grains": {"count": 0, "species": [{"diameter": "6 mm"}]},
            "cell": {"width": "60 D"},
            "piston": {"height": "20 D"},
            "effects": {"host": {"bodies": [BODY], "excitation": excitation}},
            "protocol": [{"name": "shake", "kind": "hold", "duration": duration}],
            "output": {"scalars": "2 ms", "frames": "1 s"},
        }
    )


def test_settling_time_of_an_exponential_decay_agrees_with_its_envelope() -> None:
    """The motion is exp(-delta t) cos(omega t), with ten peaks while the envelope falls to a tenth."""
    time = np.linspace(0.0, 5.0, 50_001)
    decay = np.exp(-2.0 * time) * np.cos(math.tau * 20.0 * time)
    found = settling_time_of_samples(time + 1.0, decay, 1.0, 0.1)
    assert found == pytest.approx(math.log(10.0) / 2.0, abs=0.5 / 20.0)
    assert settling_time_of_samples(time + 1.0, decay, 1.0, 0.5) < found
    with pytest.raises(InputError, match="still exceeds"):
        settling_time_of_samples(time[:5000], decay[:5000], 0.0, 0.1)
    with pytest.raises(InputError, match="below 1"):
        settling_time_of_samples(time, decay, 0.0, 1.5)


def off(length: float) -> float:
    """Return the maximum deviation of a sweep response from the steady response, relative to the peak."""
    low, high = 1.5, 6.0
    rate = math.log(high / low) / length
    time = np.linspace(0.0, length, round(500 * length) + 1)
    force = np.sin(math.tau * low * np.expm1(rate * time) / rate)
    moved = lsim(([1.0], [MASS, DAMPING, STIFFNESS]), force, time)[1]
    frequencies, (swings,) = swept_amplitudes(time, [moved + 3.0], (low, high, length), 50)
    exact = amplitude(frequencies)
    return float(np.abs(swings - exact).max() / np.abs(exact).max())


def test_a_slower_sweep_is_closer_to_the_steady_response() -> None:
    """The deviation is proportional to the sweep rate [Hz/s].

    It is below the ratio of this rate at 3.2 Hz to delta^2/(2 pi), for the decay rate delta.
    """
    once, twice = off(50.0), off(100.0)
    assert once < 3.2 * math.log(4.0) / 50.0 * math.tau / 2.0**2
    assert once / twice == pytest.approx(2.0, rel=0.1)


def test_transient_response_of_a_run_without_impulse_or_sweep_is_refused() -> None:
    run = cast("Trajectory", SimpleNamespace(scene=machine({"force": 1.0, "frequency": 3.0}, 0.1)))
    with pytest.raises(InputError, match="use an excitation of kind 'impulse'"):
        settling_time(run)
    with pytest.raises(InputError, match="no host under a sweep"):
        swept_response(run)


@pytest.mark.long  # the quick tests check invalid input and the page of a synthetic response
def test_command_response_computes_responses_to_a_sweep_and_an_impulse(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "bare.toml"
    machine({"force": 1.0, "frequency": 3.0, "start": 0.1}, 1.0).save(file)
    swept = f"response {file} --from 1.5Hz --to 6Hz --sweep 60s --json --points 40 --quiet"
    main([*swept.split(), "-o", str(tmp_path / "swept")])
    (peak,) = json.loads(capsys.readouterr().out)["peaks"]
    exact = np.abs(amplitude(np.linspace(1.5, 6.0, 1000))).max()
    assert peak["peak"] == pytest.approx(exact, rel=0.1)
    assert peak["alone"] == pytest.approx(exact, rel=1e-3)
    assert {"report.html", "response.csv", "response.png", "run"} <= {
        one.name for one in (tmp_path / "swept").iterdir()
    }
    struck = ["response", str(file), "--impulse", "--force", "50N", "--quiet", "-o", str(tmp_path / "struck")]
    with pytest.raises(InputError, match="simulate a longer time"):
        main([*struck, "--duration", "0.5s"])
    main([*struck, "--duration", "3s", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert found["alone"] == pytest.approx(math.log(10.0) / 2.0)
    assert found["seconds"] == pytest.approx(found["alone"], abs=math.pi / 20.0)
    main([*struck, "--duration", "3s", "--fraction", "0.5", "--json"])
    assert json.loads(capsys.readouterr().out)["seconds"] < found["seconds"]
    assert len((tmp_path / "struck" / "impulse.csv").read_text().splitlines()) > 1000
