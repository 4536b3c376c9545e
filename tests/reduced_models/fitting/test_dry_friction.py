"""Damping under dry friction: at observed amplitudes, not in the limit of zero amplitude."""

import dataclasses
import functools
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import PistonRecord
from reduced_models import Parameter, fit, load_model
from reduced_models.fitting.assessment import residual_structure_text
from reduced_models.laws.linearization import (
    compile_dry_friction_coefficient,
    make_rates_of_law,
    solve_harmonic_balance,
)
from reduced_models.models.at_rest import AtRest, EquivalentDamping
from reduced_models.models.printed_model import oscillation_quantities
from tests.reduced_models.made import half_width, moved, noisy

TIME = np.linspace(0.0, 40.0, 2000)
OMEGA, AMPLITUDE = 1.05, 0.6
MIXED = "z'' + 2*lam*z' + f*tanh(200*z') + k*(z - rest) = 0"
CASES = {
    "a pure decay by friction": ("coulomb", 0.0, 0.06, 5e-4),
    "a bicycle wheel that loses 1.5 % per cycle": ("coulomb", 0.0, 0.015, 5e-4),
    "a Pohl wheel with its brake": (MIXED, 0.06, 0.04, 1e-3),
    "a Pohl wheel without": (MIXED, 0.0015, 0.0025, 2e-5),
}


def released(ratio: float, loss: float, noise: float) -> PistonRecord:
    """Free oscillation with viscous damping ratio and dry friction, solved half cycle by half cycle."""
    offset = 0.25 * loss * AMPLITUDE  # of the mean position of each half cycle
    lam = ratio * OMEGA
    quick = math.sqrt(OMEGA**2 - lam**2)
    height, extreme, start = np.empty_like(TIME), AMPLITUDE, 0.0
    while start < TIME[-1]:
        level = math.copysign(offset, extreme)
        here = start <= TIME
        time = TIME[here] - start
        decaying_wave = np.cos(quick * time) + lam / quick * np.sin(quick * time)
        height[here] = level + (extreme - level) * np.exp(-lam * time) * decaying_wave
        extreme = level - (extreme - level) * math.exp(-lam * math.pi / quick)
        start += math.pi / quick
    return PistonRecord(TIME, height + np.random.default_rng(1).normal(0.0, noise, len(TIME)))


@functools.cache
def fitted(name: str) -> Any:
    """Fit of one case."""
    law, ratio, loss, noise = CASES[name]
    return fit(released(ratio, loss, noise), law, starts=1, test_fraction=0.0)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long if CASES[name][0] == MIXED else ()) for name in CASES]
)
def test_damping_ratio_with_dry_friction_refers_to_observed_amplitudes(name: str, tmp_path: Path) -> None:
    """The reference is the energy loss per cycle over 4 pi times the energy of the oscillation, in closed
    form.
    """
    _, ratio, loss, _ = CASES[name]
    model = fitted(name)
    rest, friction = model.at_rest, 0.25 * loss * AMPLITUDE * OMEGA**2
    half, tenth = rest.equivalent.amplitude, rest.equivalent.tenth_of_maximum_amplitude
    assert half == pytest.approx(0.5 * AMPLITUDE, rel=0.02)
    assert tenth == pytest.approx(0.1 * AMPLITUDE, rel=0.02)
    assert rest.period == pytest.approx(2.0 * math.pi / OMEGA, rel=1e-3)
    for size, found, (low, high) in (
        (half, rest.damping_ratio, rest.intervals["damping_ratio"]),
        (tenth, rest.equivalent.tenth_ratio, rest.equivalent.intervals["tenth_ratio"]),
    ):
        assert low <= found <= high
        wanted = ratio + 2.0 * friction / (math.pi * OMEGA**2 * size)
        assert found == pytest.approx(wanted, rel=0.05)
    assert rest.equivalent.friction == pytest.approx(friction, rel=0.1)
    for printed in (str(rest), str(model)):
        assert "friction" in printed
        assert f"of critical at {1e3 * half:.3g} mm" in printed
    model.save(tmp_path / "model.json")
    assert load_model(tmp_path / "model.json").at_rest == rest


def test_damping_interval_follows_from_the_friction_interval() -> None:
    """For a Coulomb oscillator, damping depends on friction over omega^2, and omega is known far better."""
    model = fitted("a pure decay by friction")
    fraction = 2.0 * half_width(model, "friction") / model.parameters["friction"]
    rest = model.at_rest
    ends = np.diff(rest.equivalent.intervals["friction"])[0]
    assert ends / rest.equivalent.friction == pytest.approx(fraction, rel=0.1)
    assert np.diff(rest.intervals["damping_ratio"])[0] / rest.damping_ratio == pytest.approx(
        fraction, rel=0.1
    )


def test_a_negligible_time_lag_of_the_residuals_is_not_reported(made: Any) -> None:
    """Rounding causes a tiny lag, which is not printed. A lag of a fifth of a sample is printed."""
    with pytest.warns(UserWarning, match="oscillate with the motion"):
        model = fit(made("coulomb"), "linear", starts=1, test_fraction=0.0)
    assert 0.0 < abs(model.quality.lag) < 1e-3 * TIME[1]
    assert "lags" not in str(model)
    late = dataclasses.replace(model.quality, lag=0.2 * TIME[1])
    assert "the solution lags by 0.004 s" in residual_structure_text(late, TIME[1])


def test_damping_from_peaks_is_printed_if_it_contradicts_a_fixed_damping(tmp_path: Path) -> None:
    """The damping ratio of the law was fixed by the user. The other one follows from successive peaks."""
    with pytest.warns(UserWarning, match="not right"):
        model = fit(
            released(0.02, 0.0, 1e-4),
            "linear",
            starts=1,
            test_fraction=0.0,
            parameters={"lam": Parameter(0.1 * OMEGA, fixed=True)},
        )
    rest = model.at_rest
    assert rest.damping_ratio == pytest.approx(0.1, rel=0.02)
    assert rest.peaks.low <= rest.peaks.mean <= rest.peaks.high
    assert rest.peaks.mean == pytest.approx(0.02, rel=0.02)
    for printed in (str(model), str(rest)):
        assert "the record's peaks" in printed
        assert f"{rest.damping_ratio:.4g}" not in printed
    model.save(tmp_path / "model.json")
    assert load_model(tmp_path / "model.json").at_rest == rest


def test_damping_of_small_oscillations_is_printed_if_it_applies_at_all_amplitudes() -> None:
    model = fit(released(0.06, 0.0, 1e-4), "linear", starts=1, test_fraction=0.0)
    rest = model.at_rest
    assert rest.equivalent is None
    assert rest.peaks is None
    assert rest.damping_ratio == pytest.approx(0.06, rel=1e-2)
    values = [model.parameters[name] for name in model.law.parameters]
    found = solve_harmonic_balance(make_rates_of_law(model.law, values), 0, 0.1, rest.height, OMEGA)
    assert rest.damping_ratio == pytest.approx(float(found.damping_ratio[0]), rel=1e-6)


def test_printed_friction_force_is_the_coefficient_of_the_sign_function_in_the_law() -> None:
    """The law also has quadratic drag, for which no equivalent dashpot is printed."""
    time = np.linspace(0.0, 12.0, 1200)
    motion = moved(
        lambda t, z, v: -6.0 * z - 0.06 * abs(v) * v - 0.22 * math.tanh(v / 1e-3),
        time, method="LSODA", rtol=1e-8, atol=1e-10,
    )  # fmt: skip
    law = "z'' + k*z + c*Abs(z')*z' + f*sign(z') = 0"
    model = fit(noisy(time, motion, 1e-3), law, starts=1, test_fraction=0.0)
    found = model.at_rest.equivalent
    low, high = found.intervals["friction"]
    assert low <= 0.22 <= high
    assert found.friction == pytest.approx(model.parameters["f"], rel=1e-12)
    assert found.intervals["friction"] == pytest.approx(model.intervals["f"], rel=1e-6)
    assert re.search(r"\ndry friction +F +0\.2200", str(model.at_rest))
    assert "friction" in [quantity.name for quantity in oscillation_quantities(model, None)]


@pytest.mark.parametrize(
    ("equation", "values", "coefficient"),
    [
        ("z'' + 2*lam*z' + f*tanh(20*w*z'/f) + w**2*z = g", (0.1, 0.3, 2.0, 1.0), 0.3),
        ("m*z'' + c*abs(z')*z' + f*sign(z') + k*z = 0", (2.0, 0.1, 0.4, 9.0), 0.2),
        ("z'' + c*abs(z')*z' + k*z = 0", (), None),
        ("z'' + (f + (s - f)*exp(-abs(z')/u))*sign(z') + k*z = 0", (), None),  # changes with the speed
    ],
)
def test_the_coefficient_of_the_sign_of_the_velocity_is_found_in_any_equation(
    equation: str, values: Any, coefficient: float | None
) -> None:
    found = compile_dry_friction_coefficient(equation)
    assert (found is None) == (coefficient is None)
    if found is not None:
        assert float(found(*values)) == pytest.approx(coefficient, rel=1e-12)


def test_friction_of_a_law_without_a_sign_function_is_printed_as_equivalent_friction() -> None:
    found = EquivalentDamping(0.1, 0.2, 0.3, {"tenth_ratio": (0.1, 0.3), "friction": (0.2, 0.4)})
    rest = AtRest(
        0.0, 1.0, 0.05, {"height": (0.0, 0.0), "period": (1.0, 1.0), "damping_ratio": (0.0, 0.1)}, found
    )
    assert "\nequivalent friction  Feq   0.30 ± 0.10 m/s²" in str(rest)
