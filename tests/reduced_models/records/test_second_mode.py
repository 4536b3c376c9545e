"""Second modes of free decays are found with their frequencies and fitted, and none is found in decays
of one mode.
"""

import math

import numpy as np
import pytest

from granular.shared.errors import InputError
from reduced_models import PistonRecord, fit, identify
from reduced_models.records.second_mode import SecondMode, find_second_mode
from tests.reduced_models.made import moved, noise


def decay_of_two_modes(seed: int) -> tuple[PistonRecord, float, float]:
    """Decay with 0.3 % noise, and the frequencies [Hz] of its modes."""
    random = np.random.default_rng(seed)
    first, ratio = random.uniform(0.5, 4.0), math.exp(random.uniform(math.log(1.05), math.log(6.0)))
    ratio = {0: 1.05, 1: 6.0}.get(seed, ratio)
    fraction = 0.03 if seed == 2 else math.exp(random.uniform(math.log(0.03), math.log(0.5)))
    second = first * ratio if random.random() > 0.3 or ratio < 1.2 else first / ratio
    duration = random.uniform(20.0, 50.0) / first
    time = np.linspace(0.0, duration, max(2000, int(12.0 * duration * max(first, second))))
    height = sum(
        size
        * np.exp(-ratio * math.tau * frequency * time)
        * np.cos(math.tau * frequency * time + random.uniform(0.0, math.tau))
        for size, frequency, ratio in zip(
            (1.0 - fraction, fraction), (first, second), random.uniform(0.004, 0.02, 2), strict=True
        )
    )
    return PistonRecord(time, 0.05 + 1e-3 * (height + noise(len(time), 0.003, seed))), first, second


def decay_of_one_mode(seed: int) -> PistonRecord:
    """Decay with 0.1 to 5 % noise, hum, a random walk and a parabolic drift."""
    random = np.random.default_rng(1000 + seed)
    frequency, ratio = random.uniform(0.5, 4.0), random.uniform(0.004, 0.05)
    time = np.linspace(0.0, random.uniform(15.0, 50.0) / frequency, int(random.uniform(1000, 4000)))
    height = np.exp(-ratio * math.tau * frequency * time) * np.cos(math.tau * frequency * time)
    height += random.normal(0.0, 10 ** random.uniform(-3.0, -1.3), len(time))
    if seed % 2:
        hum = random.choice([16.7, 50.0, 60.0])
        height += 10 ** random.uniform(-3.0, -1.5) * np.cos(math.tau * hum * time + 1.0)
    if seed % 3:
        height += np.cumsum(random.normal(0.0, 10 ** random.uniform(-4.5, -3.0), len(time)))
    if seed % 4 == 0:
        height += 10 ** random.uniform(-2.5, -1.3) * (time / time[-1]) ** 2
    return PistonRecord(time, height)


def second_mode_of(record: PistonRecord) -> SecondMode | None:
    return find_second_mode(record.time, record.height)


def is_right(mode: SecondMode | None, first: float, second: float) -> bool:
    if mode is None:
        return False
    return min(abs(mode.frequency / frequency - 1.0) for frequency in (first, second)) < 0.01


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_second_mode_is_found(seed: int) -> None:
    """The frequency ratio is from 1.05 to 6, and the amplitude of the mode at least 3 %."""
    record, first, second = decay_of_two_modes(seed)
    assert is_right(second_mode_of(record), first, second)


@pytest.mark.parametrize("ratio", [1.15, 1.7, 3.1])
def test_a_second_mode_of_equal_amplitude_is_found(ratio: float) -> None:
    time = np.linspace(0.0, 30.0, 3000)
    height = sum(
        np.exp(-0.01 * math.tau * frequency * time) * np.cos(math.tau * frequency * time + phase)
        for frequency, phase in ((1.0, 0.3), (ratio, 2.0))
    )
    mode = second_mode_of(PistonRecord(time, 0.05 + 1e-3 * (height + noise(3000, 0.003))))
    assert mode is not None
    assert is_right(mode, 1.0, ratio)
    assert mode.fraction == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_noise_hum_and_drift_are_not_taken_for_modes(seed: int) -> None:
    assert second_mode_of(decay_of_one_mode(seed)) is None


@pytest.mark.long  # quick: 3 and 4 of them, above
def test_second_modes_are_found_in_most_decays_of_two_modes_and_in_none_of_one() -> None:
    found = [is_right(second_mode_of(record), *pair) for record, *pair in map(decay_of_two_modes, range(15))]
    assert sum(found) >= 13
    assert not any(second_mode_of(decay_of_one_mode(seed)) for seed in range(40))


@pytest.mark.parametrize(
    "law",
    [
        lambda _, z, v: -z - 0.5 * z**3 - 0.06 * v,
        lambda _, z, v: -z - 0.4 * z**2 - 0.03 * v,
        lambda _, z, v: -z - 0.02 * np.tanh(200.0 * v),
        lambda _, z, v: -z - 1.5 * max(0.0, z) - 0.05 * v,
    ],
    ids=["hardening spring", "asymmetric spring", "dry friction", "bilinear spring"],
)
def test_a_nonlinear_decay_has_one_mode(law: object) -> None:
    """Its frequency changes, and it has harmonics."""
    time = np.linspace(0.0, 150.0, 3000)
    height = moved(law, time, 0.5, rtol=1e-8, atol=1e-10) + noise(3000, 1e-3)  # type: ignore[arg-type]
    assert second_mode_of(PistonRecord(time, height)) is None


def test_both_modes_in_one_column_are_reported_and_fitted() -> None:
    time = np.linspace(0.0, 20.0, 2000)
    modes = [
        size * np.exp(-rate * time) * np.cos(math.tau * frequency * time)
        for size, rate, frequency in ((1.0, 0.1, 0.55), (0.3, 0.2, 1.7))
    ]
    record = PistonRecord(time, 0.05 + 1e-3 * (sum(modes) + noise(2000, 0.005)))
    with pytest.warns(UserWarning, match=r"second mode at 1\.7 Hz has 23 %.*identify --coordinates 2"):
        single = fit(record, starts=2)
    assert any("second mode" in note for note in single.notes)
    found = identify(record, coordinates=2, starts=2, progress=False)
    best = found.best
    assert best.law.name == "two-modes"
    assert not any("second mode" in note for note in best.notes)
    (faster,) = best.faster_modes
    assert 1.0 / best.at_rest.period == pytest.approx(math.hypot(0.55, 0.1 / math.tau), rel=1e-4)
    assert faster.frequency == pytest.approx(math.hypot(1.7, 0.2 / math.tau), rel=1e-3)
    assert faster.damping_ratio == pytest.approx(0.2 / (math.tau * 1.7), rel=0.03)
    assert "further mode: 1.7" in found.printout()
    assert "Further mode: 1.7" in str(found.page()) or "further mode: 1.7" in str(found)


def test_the_option_coordinates_is_limited_to_one_or_two_and_excludes_given_laws() -> None:
    record, *_ = decay_of_two_modes(2)
    with pytest.raises(InputError, match="give 1 or 2"):
        identify(record, coordinates=3)
    with pytest.raises(InputError, match="remove the arguments laws"):
        identify(record, coordinates=2, laws=["linear"])
