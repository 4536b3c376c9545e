"""Frequency and damping despite correlated noise, clipping, drives, few samples or no oscillation."""

import math
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from granular import PistonRecord
from granular.shared.errors import RecordWarning
from reduced_models import fit, identify
from reduced_models.laws.linear import LINEAR
from reduced_models.records.derivatives import noise_standard_deviation, sensor_rounding_step
from reduced_models.records.envelope import find_extremes
from reduced_models.records.first_guesses import first_guesses
from reduced_models.records.sensor_artefacts import end_time_of_motion
from tests.reduced_models.made import moved, noisy

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")

REST, SIZE = 0.06, 1e-3
"""Equilibrium and first amplitude of the made decays [m]."""


def decay(frequency: float, ratio: float, rate: float, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s] and displacements [m] of a linear decay."""
    time, omega = np.arange(0.0, duration, 1.0 / rate), math.tau * frequency
    return time, SIZE * np.exp(-ratio * omega * time) * np.cos(omega * math.sqrt(1.0 - ratio**2) * time)


def quiet_fit(record: PistonRecord, law: str = "linear", starts: int = 2) -> Any:
    return fit(record, law, starts=starts)


def hum(time: np.ndarray, height: np.ndarray, random: np.random.Generator) -> np.ndarray:
    return height + 0.01 * SIZE * np.sin(math.tau * 48.7 * time)


def rounded(time: np.ndarray, height: np.ndarray, random: np.random.Generator) -> np.ndarray:
    return 0.2 * SIZE * np.round(height / (0.2 * SIZE))


def held(time: np.ndarray, height: np.ndarray, random: np.random.Generator) -> np.ndarray:
    return height[np.arange(len(height)) // 8 * 8]


def spikes(time: np.ndarray, height: np.ndarray, random: np.random.Generator) -> np.ndarray:
    hit = random.choice(len(height), 10, replace=False)
    result = height.copy()
    result[hit] += 2.0 * SIZE * random.choice([-1.0, 1.0], 10)
    return result


def second_mode(time: np.ndarray, height: np.ndarray, random: np.random.Generator) -> np.ndarray:
    return height + 0.05 * SIZE * np.exp(-0.5 * time) * np.cos(math.tau * 7.3 * time)


def remembered(time: np.ndarray, height: np.ndarray, random: np.random.Generator) -> np.ndarray:
    return height + lfilter([1.0], [1.0, -0.9], random.normal(0.0, 0.005 * SIZE, len(time)))


@pytest.mark.parametrize("disturbed", [hum, rounded, held, spikes, second_mode, remembered])
def test_frequency_and_damping_from_peaks_are_correct_or_omitted(
    disturbed: Callable[..., np.ndarray],
) -> None:
    """A peak of noise does not count, and no stated error is smaller than the scatter of the single
    values.
    """
    time, clean = decay(2.0, 0.02, 100.0, 10.0)
    random = np.random.default_rng(0)
    white = random.normal(0.0, 1e-3 * SIZE, len(time)) if disturbed in (spikes, second_mode) else 0.0
    record = PistonRecord(time, REST + disturbed(time, clean + white, random))
    found = identify(record, laws=["linear"], starts=2, progress=False)
    (ratio,) = (one for one in found.figures if one.name == "damping ratio")
    assert found.best.at_rest.peaks is None
    assert abs(ratio.value - 2.0) < 3.0 * ratio.total_error
    if found.own is None:
        assert "not measurable from peaks" in str(found)
        return
    shown = np.log(found.own.amplitudes)
    for size in (0.5, 0.1):  # of the largest
        k = int(np.abs(shown - shown[0] - math.log(size)).argmin())
        frequency, ratio = found.own.quantities_at_shown_amplitude(k)
        assert frequency.value == pytest.approx(2.0, rel=5e-3)
        assert abs(frequency.value - 2.0) < 3.0 * frequency.total_error
        assert abs(ratio.value - 2.0) < 3.0 * ratio.total_error


def test_noise_and_rounding_step_of_an_encoder_are_estimated() -> None:
    """Most of the third differences are zero, although the noise is not."""
    time, clean = decay(1.0, 0.01, 100.0, 120.0)
    step = math.tau / 2048.0
    angle = step * np.round(500.0 * clean / step)
    assert sensor_rounding_step(angle) == pytest.approx(step)
    assert noise_standard_deviation(angle, time) == pytest.approx(step / math.sqrt(12.0))
    found = find_extremes(PistonRecord(time, angle))
    high = np.flatnonzero(np.abs(found.height) > 5.0 * step)
    assert len(high) > 90
    assert np.diff(high).max() == 1
    assert np.abs(np.diff(found.time[high]) - 0.5).max() < 0.025
    assert np.diff(found.time[high]).mean() == pytest.approx(0.5, rel=1e-3)
    assert sensor_rounding_step(clean) == 0.0
    assert sensor_rounding_step(np.sign(clean)) == 0.0  # switched, not rounded


def test_peaks_are_found_although_the_half_period_changes_threefold() -> None:
    """The spring hardens elevenfold, so that half periods grow from 1.1 to 3.1 as the motion decays."""
    time = np.linspace(0.0, 200.0, 10001)
    found = find_extremes(noisy(time, moved(lambda t, z, v: -0.04 * v - z - 10.0 * z**3, time), 1e-4))
    halves = np.diff(found.time)
    assert halves[0] == pytest.approx(1.1, abs=0.1)
    assert halves[-1] == pytest.approx(3.1, abs=0.1)
    assert (np.diff(found.sign) != 0.0).all()


@pytest.mark.parametrize("level", [0.0, 3e-3])
def test_repeated_plateaus_at_one_level_are_recognised_as_clipping(level: float) -> None:
    time, clean = decay(2.0, 0.02, 100.0, 10.0)
    record = noisy(time, REST + np.clip(clean, -0.6 * SIZE, 0.6 * SIZE), level * SIZE)
    with pytest.warns(RecordWarning, match="clipped"):
        model = fit(record, "linear", starts=2)
    assert model.at_rest.damping_ratio == pytest.approx(0.02, rel=5e-3)


def test_a_decay_is_not_mistaken_for_clipping() -> None:
    time, clean = decay(2.0, 0.001, 200.0, 10.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RecordWarning)
        fit(noisy(time, REST + clean, 0.01 * SIZE), "linear", starts=1)


@pytest.mark.parametrize("frequency", [4.3, 4.8])
def test_fitted_frequency_stays_below_half_the_sampling_rate(frequency: float) -> None:
    """At 10 samples per second, 5.7 Hz would give nearly the same samples as a frequency below 5 Hz."""
    time, clean = decay(frequency, 0.002, 10.0, 30.0)
    record = noisy(time, REST + clean, 0.01 * SIZE)
    assert 1.0 / quiet_fit(record, starts=8).at_rest.period == pytest.approx(frequency, rel=2e-3)
    assert noise_standard_deviation(record.height, time) == pytest.approx(0.01 * SIZE, rel=0.3)
    assert end_time_of_motion(record) > 0.95 * time[-1]


def test_notes_on_a_poor_fit_suggest_a_drive_a_second_mode_or_growth() -> None:
    time = np.arange(0.0, 20.0, 0.005)
    steady = np.sin(math.tau * 2.2 * time)
    beat = np.exp(-0.01 * time) * np.sin(math.tau * 5.0 * time)
    beat += 0.8 * np.exp(-0.02 * time) * np.sin(math.tau * 5.6 * time)
    driven, modes, slow = (
        quiet_fit(noisy(time, REST + SIZE * height, 0.01 * SIZE)).notes
        for height in (steady, beat, np.exp(-0.005 * time) * steady)
    )
    assert any("if the motion is driven" in note for note in driven)
    assert any("two modes beat" in note for note in modes)
    assert slow == ()


def test_a_parameter_that_stays_at_zero_is_reported_with_a_remedy_that_works() -> None:
    time = np.arange(0.0, 10.0, 0.005)
    growing = noisy(time, REST + SIZE * np.exp(0.1 * time) * np.sin(math.tau * 2.0 * time), 0.01 * SIZE)
    (note,) = [one for one in quiet_fit(growing).notes if "is held at" in one]
    assert note.startswith("lam is held at its lower bound 0")
    assert f'--law "{LINEAR.equation}"' in note
    free = quiet_fit(growing, LINEAR.equation)
    assert free.parameters["lam"] == pytest.approx(-0.1, rel=0.01)
    assert free.notes == ()


def test_an_input_that_acts_with_a_delay_is_reported_with_this_delay() -> None:
    omega, late = math.tau * 2.0, 0.012

    def force(t: Any) -> Any:
        return np.sin(math.tau * 1.3 * t) + 0.7 * np.sin(math.tau * 2.9 * t + 1.0)

    time = np.linspace(0.0, 20.0, 2000)
    clean = moved(lambda t, z, v: force(t) - 0.1 * omega * v - omega**2 * z, time, 0.0)
    law = "z'' + 2*lam*z' + k*(z - rest) = gain*u"
    notes = {
        delay: quiet_fit(noisy(time, REST + clean, 1e-5, extra={"u": force(time - delay)}), law).notes
        for delay in (0.0, late)
    }
    assert not any("comes" in note for note in notes[0.0])
    assert any("u is 0.012 s late" in note for note in notes[late])


@pytest.mark.parametrize(("ratio", "duration"), [(1.7, 3.0), (2.5, 3.0), (5.0, 6.0)])
def test_the_fit_of_an_overdamped_motion_starts_from_two_exponentials(ratio: float, duration: float) -> None:
    time, omega = np.linspace(0.0, duration, 1000), math.tau
    slow, fast = (omega * (ratio + sign * math.sqrt(ratio**2 - 1.0)) for sign in (-1.0, 1.0))
    creep = SIZE * (fast * np.exp(-slow * time) - slow * np.exp(-fast * time)) / (fast - slow)
    record = noisy(time, REST + creep, 1e-3 * SIZE)
    guess = first_guesses(time, record.height)
    assert guess.decay / guess.frequency == pytest.approx(ratio, rel=0.15)
    rest = quiet_fit(record, starts=16).at_rest
    low, high = rest.intervals["damping_ratio"]
    assert low - 0.5 * (high - low) < ratio < high + 0.5 * (high - low)
    assert rest.damping_ratio == pytest.approx(ratio, rel=0.15)
