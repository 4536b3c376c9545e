"""Small oscillations compared with simulated ones, and harmonic cycles with closed forms."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.equation import compile_rates
from reduced_models.laws.law import Law
from reduced_models.laws.linearization import (
    NoOscillationReason,
    SmallOscillation,
    make_acceleration_of_equation,
    make_rates_of_law,
    small_oscillation,
    solve_harmonic_balance,
)

MAXWELL = Law("maxwell", "z'' + k*z + f*w = g; w' = z' - w/tau")
CASES = {
    "bouc-wen": (LAWS["bouc-wen"], {"omega": 5.0, "friction": 12.0, "rho": 1.0, "sigma": 0.8, "g0": 1.0}),
    "a spring behind a dashpot": (MAXWELL, {"k": 4.0, "f": 1.0, "tau": 0.5, "g": 2.0}),
    "duffing": (LAWS["duffing"], {"lam": 0.2, "k": 9.0, "rest": 0.4, "beta": 2.0}),
}


@pytest.mark.parametrize("name", CASES)
def test_small_oscillation_agrees_with_simulation(name: str) -> None:
    law, true = CASES[name]
    values = [true[key] for key in law.parameters]
    found = small_oscillation(law, values, 0.1)
    assert isinstance(found, SmallOscillation)
    field = compile_rates(law.equation, law.inputs, "numpy")
    time = np.linspace(0.0, 12.0 * found.period, 20_000)

    def rates(_: float, state: np.ndarray) -> list[float]:
        return [state[1], *field(*state, *values)]

    start = [found.z + 1e-6, 0.0, *(0.0 for _ in law.hidden)]
    height = solve_ivp(rates, (0.0, time[-1]), start, "DOP853", time, rtol=1e-11, atol=1e-19).y[0]
    # Hysteresis shifts the centre of the oscillation away from equilibrium.
    late = time > 2.0 * found.period
    swing = height - (height[late].mean() if name == "bouc-wen" else found.z)
    passages = time[1:][(np.diff(np.sign(swing)) != 0.0) & late[1:]][:9]
    damped, decay = 2.0 * np.diff(passages).mean(), 0.0
    if name != "bouc-wen":
        peaks = [np.abs(swing[(a <= time) & (time < b)]).max() for a, b in itertools.pairwise(passages)]
        decay = -float(np.polyfit(0.5 * damped * np.arange(8), np.log(peaks), 1)[0])
    omega = np.hypot(2.0 * np.pi / damped, decay)
    assert found.period == pytest.approx(2.0 * np.pi / omega, rel=0.005)
    assert found.damping_ratio == pytest.approx(decay / omega, rel=0.005, abs=1e-6)


@pytest.mark.parametrize(
    ("equation", "values", "reason"),
    [
        ("z'' - k*z = 0", [1.0], "not restoring"),
        ("z'' + c*z' + f*w = 0; w' = z' - w", [50.0, 1.0], "no isolated equilibrium"),
        ("z'' + c*z' + k*z + f*w = 0; w' = z' - w", [50.0, 1.0, 1.0], "overdamped"),
        ("z'' - k*z + f*w = 0; w' = z' - w", [9.0, 1.0], "is not stable"),
        ("z'' + f*sign(z) + k*z = 0", [0.1, 1.0], "jumps at rest"),
        ("z'' + c*z' = g", [0.1, 1.0], "no isolated equilibrium"),
    ],
)
def test_error_gives_the_reason_if_a_law_has_no_small_oscillation(
    equation: str, values: list[float], reason: str
) -> None:
    found = small_oscillation(Law("mine", equation), values, 0.0)
    assert isinstance(found, NoOscillationReason)
    assert reason in found.reason


def test_dry_friction_does_not_change_equilibrium_and_period() -> None:
    """Friction jumps at zero velocity, so that only the damping ratio of small oscillations is infinite."""
    found = small_oscillation(Law("mine", "z'' + f*sign(z') + c*z' + k*z = g"), [0.1, 0.2, 4.0, 2.0], 0.0)
    assert isinstance(found, SmallOscillation)
    assert found.z == pytest.approx(0.5, abs=1e-9)
    assert found.period == pytest.approx(np.pi)
    assert found.damping_ratio == np.inf


SIZES = np.array([0.5, 0.1])
OMEGA, LAM, FRICTION, LEVEL = 1.3, 0.05, 0.02, 0.7
RATIOS = LAM / OMEGA + 2.0 * FRICTION / (np.pi * OMEGA**2 * SIZES)


@pytest.mark.parametrize("dry", ["sign(z')", "tanh(1e6*z')"])
def test_equivalent_damping_of_friction_and_a_dashpot_has_its_closed_form(dry: str) -> None:
    law = Law("mine", f"z'' + f*{dry} + 2*lam*z' + omega**2*(z - rest) = 0")
    known = {"f": FRICTION, "lam": LAM, "omega": OMEGA, "rest": LEVEL}
    values = [known[name] for name in law.parameters]
    for rates in (make_rates_of_law(law, values), make_acceleration_of_equation(law.sympy_equation(known))):
        found = solve_harmonic_balance(rates, 0, SIZES, LEVEL + 0.01, 1.0)
        np.testing.assert_allclose(found.damping_ratio, RATIOS, rtol=1e-4)
        np.testing.assert_allclose(found.frequency, OMEGA, rtol=1e-9)
        np.testing.assert_allclose(found.centre, LEVEL, rtol=1e-9)
        dashpot = 0.5 * np.pi * SIZES * OMEGA * LAM
        np.testing.assert_allclose(found.equivalent_friction(SIZES) - dashpot, FRICTION, rtol=1e-4)


def test_harmonic_balance_accepts_arrays_of_parameters() -> None:
    """There is one cycle for each value."""
    law = Law("mine", "z'' + 2*lam*z' + k*z + b*z**3 = 0")
    lams, spring = np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0])
    together = solve_harmonic_balance(
        make_rates_of_law(law, (lams, spring, 0.5)), 0, SIZES[:, None], np.zeros(3), 1.0
    )
    assert together.damping.shape == (2, 3)
    for row, size in enumerate(SIZES):
        for k in range(3):
            alone = solve_harmonic_balance(
                make_rates_of_law(law, (lams[k], spring[k], 0.5)), 0, size, 0.0, 1.0
            )
            assert together.damping_ratio[row, k] == pytest.approx(alone.damping_ratio[0])
            # The first harmonic of a cubic spring is 3/4 b A^2 (Krylov & Bogoliubov).
            assert alone.stiffness[0] == pytest.approx(spring[k] + 0.375 * size**2)
