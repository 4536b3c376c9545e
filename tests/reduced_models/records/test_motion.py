"""The motion in a record: clipped samples and later releases are omitted with a warning."""

import dataclasses
import json
import math
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import signal

from granular.records.options import ALL, ReadOptions
from granular.shared.errors import RecordError
from reduced_models import PistonRecord, fit, read_record, read_releases
from reduced_models.fitting.fit_data import fit_data_of_record
from reduced_models.laws import LAWS
from reduced_models.records.free_motion import find_free_motion, find_free_motions
from reduced_models.records.release import active_input_names
from reduced_models.records.sources import describe_record
from tests.reduced_models.made import damped_cosine, noisy

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")

RATE, FREQUENCY, DAMPING = 500.0, 4.1, 0.05
OMEGA = 2.0 * np.pi * FREQUENCY


def decay(duration: float) -> np.ndarray:
    """Free decay from rest at amplitude 1."""
    time = np.arange(0.0, duration, 1.0 / RATE)
    quick = OMEGA * np.sqrt(1.0 - DAMPING**2)
    return np.exp(-DAMPING * OMEGA * time) * (
        np.cos(quick * time) + DAMPING * OMEGA / quick * np.sin(quick * time)
    )


def record_of(height: np.ndarray, noise: float = 0.01) -> PistonRecord:
    """Record of a height with noise."""
    noisy = height + np.random.default_rng(1).normal(0.0, noise, len(height))
    return PistonRecord(np.arange(len(height)) / RATE, 3e-3 * noisy)


def check_fit(motion: PistonRecord) -> None:
    """Assert that period and damping of the fitted motion are the true ones."""
    rest = fit(motion.first(600), "linear", test_fraction=0.0, starts=2).at_rest
    assert rest.period == pytest.approx(1.0 / FREQUENCY, rel=2e-3)
    assert rest.damping_ratio == pytest.approx(DAMPING, rel=0.03)


def lifted(duration: float) -> np.ndarray:
    """Return a lift by hand in a quarter of a second, an equally long hold, and the decay after it."""
    quarter = int(0.25 * RATE)
    lift = 0.5 - 0.5 * np.cos(np.pi * np.arange(quarter) / quarter)
    return np.concatenate([np.zeros(quarter), lift, np.ones(quarter), decay(duration)])


def found(record: PistonRecord) -> tuple[PistonRecord, list[str]]:
    """Return the motion found in a record, and the warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        motion = find_free_motion(record)
    return motion, [str(one.message) for one in caught]


def test_a_record_of_a_single_decay_is_not_cut() -> None:
    record = record_of(decay(3.0))
    motion, said = found(record)
    assert motion is record
    assert not said


@pytest.mark.parametrize("hold", [0.0, 0.1, 1.5])
def test_the_first_of_three_releases_in_a_record_is_selected(hold: float) -> None:
    piece = np.concatenate([np.ones(int(hold * RATE)), decay(2.5)])
    motion, said = found(record_of(np.concatenate([piece] * 3)))
    assert any("holds 3 releases" in words for words in said)
    assert motion.time[-1] < hold + 2.6
    check_fit(motion)


def test_clipped_peaks_are_omitted() -> None:
    record = record_of(decay(3.0))
    clipped = PistonRecord(record.time, np.clip(record.height, -2e-3, 2e-3))
    motion, said = found(clipped)
    assert any("limit of the sensor" in words for words in said)
    assert np.abs(motion.height).max() < 2e-3
    check_fit(motion)


@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_rounding_is_not_mistaken_for_clipping(noise: float) -> None:
    record = record_of(decay(3.0), noise)
    rounded = PistonRecord(record.time, np.round(record.height, 4))
    motion, said = found(rounded)
    assert len(motion) == len(rounded)
    assert not any("limit" in words for words in said)


def test_beats_are_recognised_as_one_motion() -> None:
    time = np.arange(0.0, 8.0, 1.0 / RATE)
    beats = np.cos(OMEGA * time) * (0.6 + 0.4 * np.cos(2.0 * np.pi * 0.4 * time))
    motion, said = found(record_of(beats))
    assert not any("releases" in words for words in said)
    assert len(motion) == len(time)


@pytest.mark.parametrize("number", [1, 2, 3])
def test_each_motion_in_a_record_ends_before_the_next_lift(number: int) -> None:
    record = record_of(np.concatenate([lifted(2.5)] * 3))
    motion = find_free_motion(record, number)
    assert len(find_free_motions(record)) == 3
    released = (number - 1) * (2.5 + 0.75) + 0.748
    assert motion.time[0] == pytest.approx(released, abs=0.015)
    assert motion.time[-1] < released + 2.5 + 0.25  # it rests before the next lift
    check_fit(motion)


def test_releases_are_found_in_a_record_that_consists_mostly_of_holds() -> None:
    """In the clipped record, holds fill half of the first fifth and half of the last fifth."""
    hold, lift = np.ones(int(3.0 * RATE)), lifted(1.0)[int(0.25 * RATE) : int(0.5 * RATE)]
    record = record_of(np.concatenate([hold, decay(1.5), *[lift, hold, decay(1.5)] * 2]))
    for height in (record.height, np.minimum(record.height, 2.4e-3)):
        motion, said = found(PistonRecord(record.time, height))
        assert any("holds 3 releases" in words for words in said)
        assert motion.time[0] == pytest.approx(3.0, abs=0.05)
        assert 4.0 < motion.time[-1] < 4.5


def test_the_number_of_a_missing_release_is_refused() -> None:
    record = record_of(np.concatenate([decay(2.5)] * 3))
    with pytest.raises(RecordError, match="release 4 does not exist; the record has 3"):
        find_free_motion(record, 4)
    with pytest.raises(RecordError, match="'all', but one motion is needed"):
        find_free_motion(record, ALL)
    for wrong in ("0", "some", 1.5):
        with pytest.raises(RecordError, match="give a number from 1, or 'all'"):
            ReadOptions(release=wrong)  # type: ignore[arg-type]
    with pytest.raises(RecordError, match="do not combine it with between"):
        ReadOptions(release=2, between=(0.0, 1.0))


def test_all_releases_of_a_file_are_fitted_together(tmp_path: Path, command: Callable[..., Any]) -> None:
    record_of(np.concatenate([decay(2.5)] * 3)).to_csv(file := tmp_path / "lab.csv")
    words = ("--release", "all", "--law", "linear", "--starts", "2")
    done = command("reduced_models", "fit", str(file), *words)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("model: linear (3 parameters)") == 3
    assert len(read_releases(file)) == 3
    done = command("reduced_models", "look", str(file), "--release", "2", "--json")
    assert json.loads(done.stdout)["from"] == pytest.approx(2.5, abs=0.01)


def test_motion_before_a_hold_is_omitted() -> None:
    motion, said = found(record_of(lifted(2.5)))
    assert any("brought to its release point" in words for words in said)
    assert motion.time[0] == pytest.approx(0.748, abs=0.015)
    check_fit(motion)


@pytest.mark.parametrize("strength", [0.7, 1.5])
def test_motion_after_a_knock_on_the_apparatus_is_omitted(strength: float) -> None:
    moment = 1.5
    knock = strength * np.sin(OMEGA * np.arange(int(1.5 * RATE)) / RATE)
    height = decay(3.0)
    height[int(moment * RATE) :] += knock * np.exp(-DAMPING * OMEGA * np.arange(len(knock)) / RATE)
    motion, said = found(record_of(height))
    assert any("grows suddenly" in words or "2 releases" in words for words in said)
    assert motion.time[-1] < moment
    check_fit(motion)


@pytest.mark.parametrize(
    ("frequency", "dampings", "part"),
    [
        (5.8, (0.005, 0.005), 0.3),
        (4.2, (0.005, 0.005), 0.5),
        (6.61, (0.0027, 0.0085), 0.36),
        (7.24, (0.0005, 0.0081), 0.49),
        (7.69, (0.0003, 0.0084), 0.4),
    ],
)
def test_beats_are_not_mistaken_for_a_knock(
    frequency: float, dampings: tuple[float, float], part: float
) -> None:
    """Two decaying modes are one motion, however fast the sum grows."""
    time, omegas = np.arange(0.0, 12.0, 0.005), math.tau * np.array([5.0, frequency])
    roots = omegas * (1j - np.array(dampings))
    motion = (np.exp(np.outer(time, roots)) @ [1e-3, part * 1e-3 * np.exp(1j)]).real
    _, said = found(noisy(time, motion, 1e-6))
    assert not any("grows suddenly" in words for words in said)


def test_noise_after_the_motion_is_omitted() -> None:
    motion, said = found(record_of(decay(20.0)))
    assert any("within the sensor's noise" in words for words in said)
    # 1 % of noise is reached after ln(100)/(damping omega) = 3.6 s
    assert 3.0 < motion.time[-1] < 4.2
    check_fit(motion)


def test_the_end_of_a_driven_record_is_kept() -> None:
    record = record_of(decay(20.0))
    drive = np.sin(30.0 * record.time)
    driven = PistonRecord(record.time, record.height, extra={"drive": drive})
    motion, _ = found(driven)
    assert len(motion) == len(record)


LOST = {"zeros": (0.0, 60e-3), "far outside": (-999.25, 0.0), "spikes": (None, 0.0)}


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.long if kind == "far outside" else ()) for kind in LOST]
)
def test_lost_samples_are_omitted(kind: str) -> None:
    value, level = LOST[kind]
    random = np.random.default_rng(4)
    record = record_of(decay(3.0))
    height = record.height + level
    lost = random.uniform(size=len(height)) < 0.02
    height[lost] = height[lost] + random.choice([-5e-3, 5e-3], lost.sum()) if value is None else value
    motion, said = found(PistonRecord(record.time, height))
    assert any(f"are omitted: {lost.sum()}," in words for words in said)
    assert not np.isin(record.time[lost], motion.time).any()
    check_fit(motion)


def test_samples_of_a_coarsely_sampled_motion_are_not_removed_as_outliers() -> None:
    """Examples are an oscillation with seven samples per cycle, and a bouncing piston."""
    time = np.arange(0.0, 4.0, 0.01)
    for height in (np.cos(2.0 * np.pi * time * 14.3), np.abs(np.cos(9.0 * time)) * np.exp(-time)):
        motion, said = found(PistonRecord(time, height))
        assert not any("far from" in words for words in said)
        assert len(motion) == len(time)


# Driven records, noise, and several knocks ------------------------------------------------------

DRIVES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "pulses": lambda t: np.where(t % 3.3 < 0.05, 1.0, 0.0),
    "half sines": lambda t: np.where(t % 3.3 < 0.5, np.sin(np.pi * (t % 3.3) / 0.5), 0.0),
    "bursts": lambda t: np.where(t % 3.3 < 1.0, np.sin(4.0 * np.pi * t), 0.0),
    "steps": lambda t: np.where(t % 5.0 < 2.5, 1.0, 0.0),
    "a sweep": lambda t: np.sin(2.0 * np.pi * (0.5 * t + 0.15 * t**2)),
}


def driven(drive: Callable[[np.ndarray], np.ndarray], damping: float) -> PistonRecord:
    """Oscillator of 2 Hz under a measured force, 10 s at 200 Hz with 1 % noise."""
    time, omega = np.arange(0.0, 10.0, 0.005), 4.0 * np.pi
    push = drive(time)
    steps = signal.lti([1.0], [1.0, 2.0 * damping * omega, omega**2])
    height = signal.lsim(steps, push, time)[1]
    height = 3e-3 * (height / np.abs(height).max() + np.random.default_rng(0).normal(0.0, 0.01, len(time)))
    return PistonRecord(time, height, force=push)


@pytest.mark.parametrize("damping", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("name", DRIVES)
def test_driven_record_is_not_cut(name: str, damping: float) -> None:
    record = driven(DRIVES[name], damping)
    motion, said = found(record)
    assert len(motion) == len(record)
    assert not any("omitted" in words or "is cut" in words for words in said)
    if name == "half sines" and damping == 0.1:
        assert any("'force' acts throughout the record, so the record is not cut" in words for words in said)
        assert find_free_motion(record, 1).time[-1] < 3.4  # on request
        assert len(find_free_motions(record)) == 3


@pytest.mark.parametrize("hum", [0.0, 2.0])
@pytest.mark.parametrize("count", [2000, 60_000])
def test_a_column_of_noise_and_hum_is_not_taken_as_a_drive(count: int, hum: float) -> None:
    """The noise has rare large samples, and the hum is much faster than the motion."""
    time = np.linspace(0.0, 60.0, count)
    height = 1e-3 * np.exp(-0.05 * time) * np.cos(4.0 * np.pi * time)
    for seed in range(5):
        noise = np.random.default_rng(seed).normal(size=count)
        idle = noise + hum * np.sin(2.0 * np.pi * 13.0 * time)
        assert not active_input_names(PistonRecord(time, height, force=idle))
        pushed = idle + 12.0 * (np.sin(2.0 * time) > 0.9)
        assert active_input_names(PistonRecord(time, height, force=pushed)) == ["force"]


@pytest.mark.parametrize("kind", ["white", "averaged", "resonant", "low-pass", "first order"])
def test_releases_and_knocks_are_not_found_in_noise(kind: str) -> None:
    filters = {
        "resonant": ([1.0], [1.0, -1.97, 0.98]),
        "low-pass": signal.butter(4, 5.0, fs=200.0),
        "first order": ([1.0], [1.0, -0.95]),
    }
    for seed in range(12):
        noise = np.random.default_rng(seed).normal(size=4000)
        if kind == "averaged":
            noise = np.convolve(noise, np.hanning(10 if seed % 2 else 40), "same")
        elif kind in filters:
            noise = signal.lfilter(*filters[kind], noise)
        motion, said = found(PistonRecord(0.005 * np.arange(4000), 1e-3 * noise))
        assert not any("releases" in words or "grows suddenly" in words for words in said), seed
        assert len(motion) > 3900


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("moments", [(6.0, 8.0), (6.2, 7.3), (4.0, 8.0, 12.0)])
def test_a_record_is_cut_at_each_of_several_knocks(moments: tuple[float, ...], noise: float) -> None:
    """Each knock doubles the amplitude.

    A fit of one decay to the complete record would give a third of the true damping ratio.
    """
    time, omega, damping = np.arange(0.0, 20.0, 0.005), 4.0 * np.pi, 0.02
    height = damped_cosine(time, 1.0, damping * omega, omega)
    for moment in moments:
        before, since = int(moment / 0.005), time - moment
        speed = np.gradient(height, time)[before] / omega
        blow = math.copysign(2.0 * math.hypot(height[before], speed), speed)
        ringing = np.exp(-damping * omega * np.maximum(since, 0.0)) * np.sin(omega * since)
        height = height + blow * np.where(since >= 0.0, ringing, 0.0)
    motion, said = found(noisy(time, 3e-3 * height, 3e-3 * noise, 2))
    assert any("grows suddenly" in words for words in said)
    assert not any(motion.time[0] + 0.1 < moment < motion.time[-1] - 0.1 for moment in moments)
    size = np.abs(motion.height - np.median(motion.height))
    first, last = (float(size[part].max()) for part in (slice(200), slice(-200, None)))
    duration = float(motion.time[-1] - motion.time[0]) - 1.0
    assert math.log(first / last) / (omega * duration) == pytest.approx(damping, rel=0.3)


def test_clipped_samples_are_kept_on_request(tmp_path: Path) -> None:
    """The request is ``between`` for a file or ``complete`` for a record.

    Otherwise notes report the omission.
    """
    record = record_of(decay(4.0), noise=1e-4)
    clipped = PistonRecord(record.time, np.clip(record.height, -2e-3, 2e-3))
    clipped.to_csv(file := tmp_path / "clipped.csv")
    every = (-math.inf, math.inf)
    left = fit_data_of_record(LAWS["linear"], clipped, 0.1).record
    kept = [dataclasses.replace(clipped, complete=True), read_record(file, between=every)]
    assert [len(fit_data_of_record(LAWS["linear"], entry, 0.1).record) for entry in kept] == [
        len(clipped)
    ] * 2
    cut = fit_data_of_record(LAWS["linear"], PistonRecord.from_file(file), 0.1).record
    for entry, remedy in ((left, "PistonRecord(..., complete=True)"), (cut, "--between :")):
        assert len(entry) < len(clipped)
        assert f"(clipped) are omitted; to keep them: {remedy}" in describe_record(entry)[-1]
