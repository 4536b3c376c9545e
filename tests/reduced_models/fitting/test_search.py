"""The search finds the minimum; notes on the residuals; programs are compiled once."""

import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import PistonRecord, load_scene
from reduced_models import fit, jax_setup, predict
from reduced_models.fitting.residual_diagnostics import (
    diagnose_residuals,
    fit_autoregression,
    gradient_covariance,
)
from reduced_models.fitting.residuals import _compile_residuals
from reduced_models.fitting.search import compile_fit_ahead
from reduced_models.fitting.start_values import StartDrawsNearValues
from reduced_models.laws import law_named
from reduced_models.laws.equation import PROGRAMS
from reduced_models.laws.law import Law
from reduced_models.laws.solution import _compile_adaptive_solver
from reduced_models.records.derivatives import spectral_peak_frequency
from reduced_models.records.first_guesses import first_guesses
from tests.reduced_models.made import damped_cosine, moved, noisy

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")

TIME = np.linspace(0.0, 40.0, 2000)


@pytest.mark.parametrize(
    ("stiffening", "drag", "duration", "samples", "fall"),
    [(20.0, 0.2, 40.0, 2000, 4.0), pytest.param(205.0, 0.05, 300.0, 6000, 16.0, marks=pytest.mark.long)],
)
def test_a_motion_of_falling_frequency_is_fitted(
    stiffening: float, drag: float, duration: float, samples: int, fall: float
) -> None:
    """The frequency falls to a fourth over the usual record length, or to a seventeenth over 180 cycles."""
    time = np.linspace(0.0, duration, samples)
    clean = moved(lambda t, z, v: -drag * v - z - stiffening * z**3, time, 1.4)
    halves = np.diff(time[1:][np.diff(np.sign(clean)) != 0.0])
    assert halves[-3:].mean() / halves[:3].mean() > fall
    model = fit(noisy(time, clean, 0.01 * clean.std()), "duffing")
    assert model.quality.residual < 1.05 * 0.01 * clean.std()
    assert model.parameters["beta"] == pytest.approx(stiffening, rel=0.01)
    assert model.parameters["k"] == pytest.approx(1.0, rel=0.01)


def test_a_chaotic_motion_is_fitted_from_start_values_near_the_truth() -> None:
    """The motion amplifies errors of the start and of the coarse grid by about e^6."""
    time = np.linspace(0.0, 60.0, 2000)
    record = noisy(
        time, moved(lambda t, z, v: z - z**3 - 0.25 * v + 0.3 * np.cos(t), time, 1.2), 8.7e-3, seed=1
    )
    start = {"c0": -0.24961, "c1": 0.99874, "c2": -0.99808, "c3": 0.29925, "w": 1.00005}
    equation = "z'' = c0*z' + c1*z + c2*z**3 + c3*cos(w*t)"
    law = Law("two wells", equation, start=StartDrawsNearValues(start), source="this test")
    model = fit(record, law, starts=4, test_fraction=0.0)
    assert model.quality.residual < 1.05 * 8.7e-3
    assert model.parameters["w"] == pytest.approx(1.0, rel=1e-3)


def test_start_values_include_other_frequencies_if_the_period_changes() -> None:
    chirp = np.exp(-0.05 * TIME) * np.cos(8.0 * TIME - 0.08 * TIME**2)
    guess = first_guesses(TIME, chirp)
    assert max(guess.rivals) == pytest.approx(7.9, rel=0.1)
    assert guess.shortest_cycle_period <= guess.period
    steady = first_guesses(TIME, np.cos(3.0 * TIME))
    assert steady.rivals == ()
    assert spectral_peak_frequency(TIME, np.cos(3.0 * TIME)) == pytest.approx(3.0, rel=0.01)


def test_a_slightly_wrong_law_is_reported(made: Callable[..., PistonRecord]) -> None:
    """The misfit oscillates with the motion.

    Its rms is below 2 % of the rms displacement, but above the noise.
    """
    clean = moved(lambda t, z, v: -0.1 * v - 0.02 * abs(v) * v - 1.05**2 * z - 1.0, TIME)
    with pytest.warns(UserWarning, match="are not white noise"):
        wrong = fit(noisy(TIME, clean, 0.002 * clean.std()), "linear")
    assert wrong.quality.has_structured_residuals
    assert wrong.quality.relative < 0.02
    assert "and oscillate with the motion, so the law is not right" in " ".join(str(wrong).split())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        right = fit(made("linear"), "linear")
    assert not right.quality.has_structured_residuals
    assert right.quality.collocation == "same"
    assert "and so does a fit to accelerations" in str(right)


def test_fit_to_accelerations_escapes_from_a_wrong_local_minimum(made: Callable[..., PistonRecord]) -> None:
    """A fit to the motion alone, from a single start at half the frequency, would explain nothing."""
    with pytest.warns(UserWarning, match="only 0 of 1 random starts"):
        model = fit(made("linear"), "linear", starts=1, parameters={"omega": 0.5})
    assert model.quality.collocation == "better"
    assert model.quality.relative < 0.011
    assert model.parameters["omega"] == pytest.approx(1.05, rel=0.01)


def test_correlated_noise_is_not_reported_as_oscillating_residuals(made: Callable[..., PistonRecord]) -> None:
    """The residuals are not white, but do not contradict the law."""
    from scipy.signal import lfilter

    clean = made("linear", level=0.0)
    noise = lfilter([1.0], [1.0, -0.6], np.random.default_rng(3).normal(size=len(clean)))
    record = PistonRecord(clean.time, clean.height + 0.01 * clean.height.std() * noise)
    with pytest.warns(UserWarning, match="or the noise is not white"):
        model = fit(record, "linear")
    assert model.quality.swinging < 0.5
    assert "oscillate with the motion" not in str(model)


def test_diagnostics_recognise_white_lagging_and_drifting_residuals() -> None:
    random = np.random.default_rng(0)
    motion, white = np.sin(3.0 * TIME), random.normal(size=2000)
    speed, period = 3.0 * np.cos(3.0 * TIME), 2.0 * np.pi / 3.0
    plain = diagnose_residuals(TIME, white, speed, period)
    assert min(plain["whiteness"], plain["signs"]) > 1e-3
    late = diagnose_residuals(TIME, white + 5.0 * speed * 0.1, speed, period)
    assert late["lag"] == pytest.approx(0.5, rel=0.1)
    assert late["swinging"] > 0.5
    assert late["whiteness"] < 1e-12
    slow = diagnose_residuals(TIME, white + np.cumsum(0.2 * random.normal(size=2000)), speed, period)
    assert slow["drift"] > 10.0
    assert slow["slow"] > slow["swinging"]
    assert diagnose_residuals(TIME, 0.0 * motion, speed, period)["whiteness"] == 1.0


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.99])
def test_gradient_covariance_of_correlated_noise_agrees_with_its_exact_value(memory: float) -> None:
    """The covariance is estimated by an autoregression, for a mean and for an oscillation."""
    from scipy.signal import lfilter

    random = np.random.default_rng(1)
    noise = lfilter([1.0], [1.0, -memory], random.normal(size=8000))[4000:]
    slopes = np.stack([np.ones(4000), np.sin(0.1 * np.arange(4000))], axis=1)
    found = gradient_covariance(slopes, noise, fit_autoregression(noise))
    power = [1.0 / abs(1.0 - memory * np.exp(1j * angle)) ** 2 for angle in (0.0, 0.1)]
    assert found[0, 0] == pytest.approx(4000.0 * power[0], rel=0.5)
    assert found[1, 1] == pytest.approx(2000.0 * power[1], rel=0.2)


def test_noise_estimate_by_autoregression_is_unbiased_for_short_records() -> None:
    """Residuals about a fitted mean give on average the low-frequency power of the noise."""
    from scipy.signal import lfilter

    found = []
    for seed in range(200):
        long = np.random.default_rng(seed).normal(size=800)
        noise = lfilter([1.0], [1.0, -0.95], long)[400:]
        weights = fit_autoregression(noise - noise.mean()).weights
        if len(weights) == 1:
            found.append(weights[0])
    assert len(found) > 180
    assert np.mean(found) == pytest.approx(0.95, abs=0.004)


@pytest.mark.long
def test_every_seed_finds_the_same_fit_of_a_fall() -> None:
    """The oscillating solution of the Van der Pol-like law lies in another minimum."""
    time = np.linspace(0.0, 2.88, 2000)
    fall = predict(load_scene("damper")).simulate(time)
    found = [fit(fall, "van-der-pol-like", seed=seed, test_fraction=0.0) for seed in range(2)]
    residual_sizes = np.array([model.quality.residual for model in found])
    np.testing.assert_allclose(residual_sizes, residual_sizes[0], rtol=1e-3)
    assert residual_sizes[0] < 0.09 * np.ptp(fall.height)


def test_a_fit_uses_the_programs_that_were_compiled_in_advance(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The fit itself compiles only the residuals of all samples.

    A second call compiles nothing in advance.
    """
    compiled: list[str] = []

    def follow(label: str, *args: Any) -> Any:
        if not jax_setup._program_path(label).exists():
            compiled.append(label.split("<locals>.")[1].split(maxsplit=1)[0])
        return load_or_compile(label, *args)

    def compiled_by(act: Callable[[], Any]) -> list[str]:
        _compile_residuals.cache_clear()
        _compile_adaptive_solver.cache_clear()
        compiled.clear()
        act()
        return list(compiled)

    load_or_compile, law = jax_setup._load_or_compile, law_named("linear")
    monkeypatch.setattr(jax_setup, "_folder", tmp_path)
    monkeypatch.setattr(jax_setup, "_load_or_compile", follow)
    assert compiled_by(lambda: compile_fit_ahead(law, 4)) == ["normal_equations", "solve"]
    assert compiled_by(lambda: compile_fit_ahead(law, 4)) == []
    record = PistonRecord(TIME, damped_cosine(TIME, 1.0, 0.05, 1.0))
    assert compiled_by(lambda: fit(record, law, starts=4)) == ["residuals_and_derivatives_of_one_vector"]
    compiled_by(lambda: None)


PROGRAM = """
import resource, sys
import numpy as np
from granular import PistonRecord
from reduced_models import fit

time = np.linspace(0.0, 3.0, 400)
noise = np.random.default_rng(0).normal(0.0, 1e-6, 400)
record = PistonRecord(time, 0.06 + 2e-3 * np.exp(-0.3 * time) * np.cos(10.0 * time) + noise)
UNIT = 2**20 if sys.platform == "darwin" else 2**10

def memory(laws, times=1):
    for k in laws:
        for _ in range(times):
            fit(record, f"z'' + {k}.5*c*z' + k*(z - r) = 0", starts=2, test_fraction=0.0)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / UNIT

kept = int(sys.argv[1])
print(memory(range(kept + 2)), memory(range(kept + 2, kept + 10)), memory([kept + 9], 40))
"""


@pytest.mark.long
def test_repeated_fits_do_not_accumulate_memory() -> None:
    """Eight more laws than the cache keeps, of 20 to 40 MB each, and forty fits of one law are tested."""
    said = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", PROGRAM, str(PROGRAMS)],
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    print(said)
    first, second, third = map(float, said.split())  # MB
    assert second - first < 8 * 8.0
    assert third - second < 10.0
