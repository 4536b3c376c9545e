"""A filter of the sensor is suggested if it halves the residual, but not for a nonlinear decay."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from reduced_models import PistonRecord, fit
from reduced_models.records.sensor_filter import find_sensor_filter
from tests.reduced_models.made import moved, noise
from tests.reduced_models.records.test_second_mode import decay_of_one_mode, decay_of_two_modes

TIME = np.linspace(0.0, 20.0, 2000)
RATE = 0.15


def behind_low_pass(corner: float) -> PistonRecord:
    """Return a decay at 0.8 Hz from 51 mm to 50 mm, as seen through a first-order low-pass filter [Hz]."""
    pull = math.tau * corner
    solved = solve_ivp(
        lambda t, y: [pull * (50.0 + math.exp(-RATE * t) * math.cos(math.tau * 0.8 * t) - y[0])],
        (0.0, 20.0),
        [50.0],
        t_eval=TIME,
        rtol=1e-9,
        atol=1e-9,
    )
    return PistonRecord(TIME, 1e-3 * (solved.y[0] + noise(2000, 0.003)))


@pytest.mark.parametrize("corner", [0.3, 1.0, 3.0])
def test_the_corner_frequency_of_a_low_pass_filter_is_found(corner: float) -> None:
    record = behind_low_pass(corner)
    found = find_sensor_filter(record.time, record.height, 1.2e-5)
    assert found is not None
    assert found.kind == "low_pass"
    assert found.corner == pytest.approx(corner, rel=0.05)


def test_a_fit_suggests_the_filter_of_the_sensor() -> None:
    """Without the filter, the fitted damping is 10 % too small."""
    with pytest.warns(
        UserWarning, match=r'low pass filter of the sensor, at about 1 Hz.*--measured "height low_pass=1"'
    ):
        model = fit(behind_low_pass(1.0), starts=2, test_fraction=0.0)
    assert model.parameters["lam"] < 0.95 * RATE


@pytest.mark.parametrize("seed", range(4))
def test_one_or_two_modes_with_noise_need_no_filter(seed: int) -> None:
    for record in (decay_of_one_mode(seed), decay_of_two_modes(seed)[0]):
        assert find_sensor_filter(record.time, record.height, float(record.height.std())) is None


@pytest.mark.parametrize(
    "law",
    [
        lambda _, z, v: -z - 0.4 * z**2 - 0.03 * v,
        lambda _, z, v: -z - 0.02 * np.tanh(200.0 * v),
        lambda _, z, v: -z - 1.5 * max(0.0, z) - 0.05 * v,
    ],
    ids=["asymmetric spring", "dry friction", "bilinear spring"],
)
def test_no_sensor_filter_is_found_in_a_nonlinear_decay_whose_mean_changes(law: object) -> None:
    time = np.linspace(0.0, 150.0, 3000)
    height = moved(law, time, 0.5, rtol=1e-8, atol=1e-10) + noise(3000, 1e-4)  # type: ignore[arg-type]
    assert find_sensor_filter(time, height, float(height.std())) is None
