"""The hold before a release is omitted; a record without a hold stays unchanged."""

import math
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import PistonRecord, simulate
from granular.shared.errors import RecordWarning
from reduced_models import cut_at_release, fit, identify, read_record
from reduced_models.records.record_overview import overview_of_record_file
from reduced_models.records.release import release_sample_index
from tests.reduced_models.made import moved

FREQUENCY, DAMPING = 4.1, 0.05
OMEGA = 2.0 * np.pi * FREQUENCY  # undamped


def free(since: np.ndarray, height: float = 1.0, velocity: float = 0.0) -> np.ndarray:
    """Free decay that is at rest before its release."""
    rate, since = DAMPING * OMEGA, np.maximum(since, 0.0)
    quick = OMEGA * math.sqrt(1.0 - DAMPING**2)
    oscillation = height * np.cos(quick * since)
    oscillation += (velocity + rate * height) / quick * np.sin(quick * since)
    return np.asarray(np.exp(-rate * since) * oscillation)


def record(
    hold: float, noise: float = 0.0, *, rate: float = 1000.0, kicked: bool = False, count: float = 0.0,
    seed: int = 0,
) -> PistonRecord:  # fmt: skip
    """Return a hold, or rest before a kick, followed by 4 s of oscillation that starts 3 mm above 61 mm."""
    time = np.arange(0.0, hold + 4.0, 1.0 / rate)
    height = free(time - hold, 0.0, OMEGA) if kicked else free(time - hold)
    height += noise * np.random.default_rng(seed).standard_normal(len(time))
    return PistonRecord(time, 0.061 + 0.003 * (np.round(height / count) * count if count else height))


@pytest.mark.parametrize("kicked", [False, True], ids=["released", "kicked"])
@pytest.mark.parametrize("hold", [0.05, 0.25, pytest.param(2.0, marks=pytest.mark.long)])
def test_the_hold_before_a_motion_is_cut_at_the_release(hold: float, kicked: bool) -> None:
    """The cut is at most a twentieth of a cycle late.

    If it is early, the remaining hold is too short to matter.
    """
    made = [
        record(hold, noise, rate=rate, kicked=kicked, count=count, seed=seed)
        for noise, seeds in ((0.0, 1), (0.005, 3), (0.01, 3), (0.03, 5))
        for seed in range(seeds)
        for rate in ((500.0, 1000.0, 5000.0) if noise < 0.03 else (1000.0, 5000.0))
        for count in (0.0, 0.01)
    ]
    ends = np.array([one.time[release_sample_index(one)] for one in made])
    assert np.abs(ends - hold - 0.0025).max() < 0.01


@pytest.mark.parametrize("noise", [0.0, 0.005, 0.03])
def test_record_without_a_hold_is_not_cut(noise: float) -> None:
    """The record was already cut, or starts at an arbitrary phase of an oscillation."""
    oscillation = record(2.0, noise, seed=7)
    for start in np.arange(2.0, 2.5, 0.008):
        assert release_sample_index(oscillation.between(start, math.inf)) == 0


def driven(push: Callable[[float], float]) -> np.ndarray:
    """Response of an oscillator at rest to a force."""
    return moved(
        lambda t, z, v: OMEGA**2 * (push(t) - z) - 2.0 * DAMPING * OMEGA * v,
        TIME, 0.0, rtol=1e-8, max_step=0.01,
    )  # fmt: skip


TIME = np.arange(0.0, 5.0, 0.002)
PHASE = OMEGA * TIME
WITHOUT_HOLD: dict[str, Callable[[], np.ndarray]] = {
    "undamped": lambda: np.cos(PHASE),
    "undamped, from before a turning point": lambda: np.cos(PHASE - 0.4),
    "critically damped": lambda: (1.0 + PHASE) * np.exp(-PHASE),
    "overdamped": lambda: 1.2 * np.exp(-PHASE / 5.0) - 0.2 * np.exp(-PHASE),
    "creep": lambda: 1.0 - np.exp(-3.0 * TIME),
    "fall": lambda: -4.9 * TIME**2,
    "line": lambda: TIME,
    "growing": lambda: np.exp(0.8 * TIME) * np.sin(PHASE),
    "beats": lambda: np.sin(PHASE) * np.sin(0.05 * PHASE),
    "dry friction": lambda: (1.0 - TIME / 5.0) * np.cos(PHASE),
    "bouncing": lambda: np.abs(np.cos(PHASE)) * np.exp(-TIME),
    "at resonance": lambda: driven(lambda t: math.sin(OMEGA * t)),
    "below it": lambda: driven(lambda t: math.sin(0.1 * OMEGA * t)),
    "sweep": lambda: driven(lambda t: math.sin(2.0 * math.pi * t * (0.1 + 0.8 * t))),
    "step": lambda: driven(lambda t: 1.0),
    "ramp": lambda: driven(lambda t: min(t, 1.0)),
    "rest": lambda: np.zeros_like(TIME),
}


@pytest.mark.parametrize("name", WITHOUT_HOLD)
def test_motion_without_a_hold_is_unchanged(name: str) -> None:
    """No sample is dropped, whether heights are exact, noisy or rounded."""
    motion = WITHOUT_HOLD[name]()
    motion /= np.abs(motion).max() or 1.0
    for noise, seeds in ((0.0, 1), (0.005, 3), (0.03, 3)):
        for seed in range(seeds):
            height = motion + noise * np.random.default_rng(seed).standard_normal(len(TIME))
            for each in (height, 0.01 * np.round(height / 0.01)):
                made = PistonRecord(TIME, each)
                assert cut_at_release(made) is made, (noise, seed)


@pytest.mark.parametrize("start", [1e-2, 1e-4])
def test_gradual_start_from_an_unstable_equilibrium_is_not_cut(start: float) -> None:
    """A pendulum near its top and a van der Pol oscillation start below the noise."""
    for noise in (0.0, 1e-3):
        random = np.random.default_rng(2)
        for law in (
            lambda t, y: [y[1], -(OMEGA**2) * np.sin(y[0])],
            lambda t, y: [y[1], OMEGA * (0.4 * (1.0 - (y[0] - 3.14) ** 2) * y[1] - OMEGA * (y[0] - 3.14))],
        ):
            found = solve_ivp(law, (0.0, 5.0), [3.14159265 - start, 0.0], t_eval=TIME, rtol=1e-8)
            height = found.y[0] + noise * random.standard_normal(len(TIME))
            assert release_sample_index(PistonRecord(TIME, height)) == 0


def test_the_cut_before_a_release_keeps_a_pulse_at_the_release_and_all_of_a_drive() -> None:
    """The pulse starts the motion. The drive already acts before the release, while the part sticks."""
    kicked = record(0.5, 0.005, kicked=True)
    pulse = np.where(np.abs(kicked.time - 0.496) < 0.004, 1.0, 0.0)
    clock, load = np.arange(len(kicked.time)) / 7.0, np.where(kicked.time < 0.5, 3.0, 0.0)

    def with_columns(**extra: np.ndarray) -> PistonRecord:
        return PistonRecord(kicked.time, kicked.height, extra=extra)

    found = with_columns(hammer=pulse)
    assert 0.49 <= found.time[release_sample_index(found)] <= pulse.argmax() / 1000.0 + 1e-9
    noisy = np.random.default_rng(0).standard_normal(len(clock))
    warm = 20.0 + (kicked.time % 0.7)
    for extra in ({"clock": clock}, {"load": load}, {"input noise": noisy}, {"temperature": warm}):
        found = with_columns(**extra)
        assert found.time[release_sample_index(found)] == pytest.approx(0.5, abs=0.005)
    assert release_sample_index(with_columns(drive=np.sin(2.0 * kicked.time))) == 0


def test_simulated_record_is_not_cut(small_damper: Any) -> None:
    """The piston starts at rest and is released at once."""
    run = simulate(small_damper, dt="auto*4", progress=False)
    made = run.piston()
    assert cut_at_release(made) is made


# In files ------------------------------------------------------------------------------------


@pytest.fixture
def held(tmp_path: Path) -> Path:
    record(0.4, 0.01, rate=500.0).to_csv(tmp_path / "held.csv")
    return tmp_path / "held.csv"


def test_a_file_is_read_from_its_release_on(held: Path) -> None:
    """A one-line warning reports this.

    Times given as an argument or in a description file take precedence.
    """
    with pytest.warns(RecordWarning, match=r"is at rest until 0\.\d+ s and is cut there") as said:
        cut = read_record(held)
    assert len(said) == 1
    assert cut.time[0] == pytest.approx(0.4, abs=0.01)
    assert str(overview_of_record_file(held)).count("note: the record is at rest until") == 1
    assert overview_of_record_file(held).record.time[0] == cut.time[0]
    (held.parent / "record.toml").write_text('file = "held.csv"\nbetween = [0.1, 3.0]\n')
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(PistonRecord.from_file(held)) == 2200
        assert len(read_record(held, between=(-math.inf, math.inf))) == 2200
        assert read_record(held.parent / "record.toml").time[0] == pytest.approx(0.1)
        assert overview_of_record_file(held.parent / "record.toml").record.time[0] == pytest.approx(0.1)


@pytest.mark.parametrize(
    "hold", [0.05, *(pytest.param(hold, marks=pytest.mark.long) for hold in (0.25, 0.5))]
)
def test_motion_after_a_hold_is_identified(hold: float, tmp_path: Path) -> None:
    record(hold, 0.01, rate=500.0).to_csv(tmp_path / "held.csv")
    with pytest.warns(RecordWarning, match="is at rest until"):
        found = identify(tmp_path / "held.csv", laws=["linear"], progress=False)
    assert found.figure("natural frequency").value == pytest.approx(FREQUENCY, rel=1e-3)
    assert found.figure("damping ratio").value == pytest.approx(100.0 * DAMPING, rel=0.02)


def test_a_fit_through_a_hold_gives_a_note() -> None:
    """A record created in Python is not cut. The note does not recommend another law."""
    with pytest.warns(UserWarning, match=r"is at rest for the first 0\.5\d* s, during which"):
        fit(record(0.5, 0.01, rate=500.0), "linear")
