"""The uncertainty of a sensor's calibration enters the intervals of what is fitted."""

from __future__ import annotations

import numpy as np
import pytest

from reduced_models import FitOptions, PistonRecord, ReducedModel, fit

TIME = np.arange(2000) / 1000.0
OMEGA = 2.0 * np.pi * 4.1
NOISE = np.random.default_rng(1).normal(0.0, 3e-5, len(TIME))
HEIGHT = 0.06 + 0.003 * np.exp(-0.05 * OMEGA * TIME) * np.cos(OMEGA * TIME) + NOISE
RAW = HEIGHT / 2.5e-3 + 2.5


def read(scale: str, zero: str = "2.5 V", **more: np.ndarray) -> PistonRecord:
    """Record of a sensor in volts."""
    table = {"time [s]": TIME, "height [V]": RAW} | more
    return PistonRecord.from_table(table, scale={"height": scale}, zero={"height": zero})


def spread(model: ReducedModel, name: str) -> float:
    """Half of an interval."""
    low, high = model.intervals[name]
    return 0.5 * (high - low)


def test_each_parameter_gets_what_another_scale_would_move_it() -> None:
    plain, wide, moved = (
        fit(read(scale), "duffing", starts=1) for scale in ("2.5 mm/V", "2.5 +- 0.02 mm/V", "2.52 mm/V")
    )
    quantile = 1.9608
    for name, value in plain.parameters.items():
        shift = quantile * (moved.parameters[name] - value)
        expected = np.hypot(spread(plain, name), shift)
        assert spread(wide, name) == pytest.approx(expected, rel=0.03), name
    assert wide.at_rest is not None
    assert plain.at_rest is not None
    low, high = wide.at_rest.intervals["height"]
    assert 0.5 * (high - low) == pytest.approx(quantile * 0.06 * 0.008, rel=0.03)
    assert wide.at_rest.intervals["period"] == pytest.approx(plain.at_rest.intervals["period"], rel=1e-6)


@pytest.fixture(scope="module")
def linear() -> ReducedModel:
    """A fit with intervals by the linearised covariance."""
    return fit(read("2.5 +- 0.02 mm/V"), "linear")


def test_profiles_have_it_too(linear: ReducedModel) -> None:
    profiled = fit(read("2.5 +- 0.02 mm/V"), "linear", intervals="profile")
    assert spread(profiled, "g0") == pytest.approx(spread(linear, "g0"), rel=0.1)


def test_one_sensor_of_several_records_does_not_average_out() -> None:
    record = read("2.5 mm/V", "2.5 +- 0.2 V")
    (alone,), together = (fit([record] * count, "linear") for count in (1, 2))
    assert spread(together[0], "g0") == pytest.approx(spread(alone, "g0"), rel=1e-3)


@pytest.mark.long  # quick: `test_driven`
def test_the_scale_of_a_force_moves_the_mass_that_it_drives() -> None:
    from scipy.signal import lsim

    volts = np.sin(2.0 * np.pi * (1.0 + TIME) * TIME)
    system = ([0.2], [1.0, 0.1 * OMEGA, OMEGA**2])
    swing = lsim(system, 60.0 * volts, TIME)[1] + NOISE
    table = {"time [s]": TIME, "height [m]": swing, "cell [V]": volts}
    record = PistonRecord.from_table(table, columns={"force": "cell"}, scale={"force": "60 +- 1.2 N/V"})
    law = "z'' + c*z' + k*z = force/m"
    model = fit(record, law, starts=1, test_fraction=0.0, options=FitOptions(input_interpolation="linear"))
    assert model.parameters["m"] == pytest.approx(5.0, rel=0.01)
    assert spread(model, "m") == pytest.approx(1.96 * 0.02 * model.parameters["m"], rel=0.05)
