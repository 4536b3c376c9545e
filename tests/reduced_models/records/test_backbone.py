"""Frequency and damping against amplitude, told by a record alone, against what a made one has."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import PistonRecord
from granular.shared.errors import RecordError
from reduced_models import fit
from reduced_models.models.printed_model import swing_quantities
from reduced_models.records.backbone import driven_backbone, free_backbone

SEEDS = range(10)
KINDS = ("dry", "dry and viscous", "quadratic")


def decay(kind: str, seed: int, samples: int = 3000) -> tuple[PistonRecord, Callable[[float], float], float]:
    """A made free decay with noise, its damping ratio at an amplitude, and its angular frequency."""
    random = np.random.default_rng(seed)
    omega, size = math.tau * random.uniform(1.5, 5.0), random.uniform(1e-3, 8e-3)
    halves = random.uniform(4.0, 12.0)  # half swings until friction stops it
    friction = 0.0 if kind == "quadratic" else omega**2 * size / (4.0 * halves)
    lam = omega * random.uniform(0.005, 0.03) if "viscous" in kind else 0.0
    drag = random.uniform(0.02, 0.15) / size if kind == "quadratic" else 0.0
    time = np.linspace(0.0, (24.0 if drag else 12.0) * math.tau / omega, samples)

    def rates(_: float, y: np.ndarray) -> list[float]:
        z, v = y
        slip = math.tanh(v / (1e-3 * omega * size))
        return [v, -(omega**2) * z - 2.0 * lam * v - friction * slip - drag * abs(v) * v]

    solved = solve_ivp(rates, (0.0, time[-1]), [size, 0.0], "LSODA", time, rtol=1e-9, atol=1e-12)
    noise = random.choice([1e-4, 1e-3, 5e-3]) * size
    record = PistonRecord(time, 0.06 + solved.y[0] + random.normal(0.0, noise, len(time)))

    def ratio(amplitude: float) -> float:
        dry = 2.0 * friction / (math.pi * omega**2 * amplitude)
        return lam / omega + dry + 4.0 * drag * amplitude / (3.0 * math.pi)

    return record, ratio, omega


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "seed", [SEEDS[0], *(pytest.param(seed, marks=pytest.mark.long) for seed in SEEDS[1:])]
)
def test_damping_at_an_amplitude(kind: str, seed: int) -> None:
    """Within a tenth where the headline names one, though it changes tenfold within the record."""
    record, ratio, omega = decay(kind, seed)
    found = free_backbone(record)
    for amplitude in found.amplitudes_to_show(1e3):
        swing = found.interpolate_at(amplitude)
        assert swing.damping_ratio == pytest.approx(ratio(amplitude), rel=0.1)
        assert swing.frequency == pytest.approx(omega, rel=0.01)
    assert (found.damping_ratio < 1.0).all()


def test_errors_of_a_noisy_linear_decay_hold_the_truth() -> None:
    time, inside = np.linspace(0.0, 5.0, 2500), []
    for seed in range(10):
        noise = np.random.default_rng(seed).normal(0.0, 2e-5, len(time))
        record = PistonRecord(time, 0.06 + 1e-3 * np.exp(-0.4 * time) * np.cos(20.0 * time) + noise)
        swing = free_backbone(record).interpolate_at(5e-4)
        inside.append(abs(swing.damping_ratio - 0.02) < swing.damping_error)
        inside.append(abs(swing.frequency - 20.0) < swing.frequency_error)
    assert np.mean(inside) > 0.8


@pytest.mark.parametrize("beta", [0.0, 3e7])
def test_a_driven_swing_by_its_restoring_force(beta: float) -> None:
    """A sweep through resonance: linear, and with a spring that hardens by 3/4 beta A^2."""
    time = np.linspace(0.0, 40.0, 20001)
    omega, lam = 20.0, 0.6

    def push(t: np.ndarray | float) -> np.ndarray | float:
        return 0.08 * np.sin((14.0 + 0.15 * t) * t)

    solved = solve_ivp(
        lambda t, y: [y[1], push(t) - omega**2 * y[0] - beta * y[0] ** 3 - 2.0 * lam * y[1]],
        (0.0, time[-1]),
        [0.0, 0.0],
        "LSODA",
        time,
        rtol=1e-9,
        atol=1e-12,
    )
    noise = np.random.default_rng(0).normal(0.0, 1e-7, len(time))
    found = driven_backbone(PistonRecord(time, 0.06 + solved.y[0] + noise), lambda z, v: push(time))
    for amplitude in found.amplitudes_to_show(1e3)[:2]:
        swing = found.interpolate_at(amplitude)
        expected = math.sqrt(omega**2 + 0.75 * beta * amplitude**2)
        assert swing.frequency == pytest.approx(expected, rel=0.01)
        assert swing.damping_ratio == pytest.approx(lam / expected, rel=0.1)


def test_noise_alone_has_no_backbone() -> None:
    noise = np.random.default_rng(0).normal(0.0, 1.0, 4000)
    with pytest.raises(RecordError, match="extremes"):
        free_backbone(PistonRecord(np.linspace(0.0, 60.0, 4000), noise))


@pytest.mark.long  # quick: damping ratios in `test_dry_friction`
@pytest.mark.parametrize("law", ["coulomb", "linear", "viscous-coulomb", "viscous-quadratic"])
@pytest.mark.parametrize("kind", KINDS)
def test_no_law_has_more_than_critical_damping_for_what_swings(kind: str, law: str) -> None:
    """Whatever law is fitted, also one that is wrong; the seed has the most friction of all."""
    record, *_ = decay(kind, 0, 2000)  # as many as elsewhere: their code is compiled already
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = fit(record, law, starts=2, test_fraction=0.0)
    ratios = [
        figure.value for figure in swing_quantities(model, None) if figure.name.startswith("damping ratio")
    ]
    assert all(ratio < 100.0 for ratio in ratios)
    assert law == "linear" or ratios
