"""Period and damping at rest against small swings that are simulated."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.equation import compile_rates
from reduced_models.laws.law import Law
from reduced_models.laws.linearization import NoSwing, SmallSwing, small_swing

MAXWELL = Law("maxwell", "z'' + k*z + f*w = g; w' = z' - w/tau")
CASES = {
    "bouc-wen": (LAWS["bouc-wen"], {"omega": 5.0, "friction": 12.0, "rho": 1.0, "sigma": 0.8, "g0": 1.0}),
    "a spring behind a dashpot": (MAXWELL, {"k": 4.0, "f": 1.0, "tau": 0.5, "g": 2.0}),
    "duffing": (LAWS["duffing"], {"lam": 0.2, "k": 9.0, "rest": 0.4, "beta": 2.0}),
}


@pytest.mark.parametrize("name", CASES)
def test_a_small_swing_is_as_simulated(name: str) -> None:
    from scipy.integrate import solve_ivp

    law, true = CASES[name]
    values = [true[key] for key in law.parameters]
    found = small_swing(law, values, 0.1)
    assert isinstance(found, SmallSwing)
    field = compile_rates(law.equation, law.inputs, "numpy")
    size, hidden = 1e-6, [0.0] * len(law.hidden)
    motion = solve_ivp(
        lambda _, state: [state[1], *field(*state, *values)],
        (0.0, 12.0 * found.period),
        [found.z + size, 0.0, *hidden],
        "DOP853",
        rtol=1e-11,
        atol=1e-19,
        t_eval=np.linspace(0.0, 12.0 * found.period, 20_000),
    )
    # Hysteresis holds a swing about another level than that of rest.
    late = motion.t > 2.0 * found.period
    swing = motion.y[0] - motion.y[0][late].mean() if name == "bouc-wen" else motion.y[0] - found.z
    passages = motion.t[1:][(np.diff(np.sign(swing)) != 0.0) & late[1:]]
    damped = 2.0 * np.diff(passages[:9]).mean()
    if name == "bouc-wen":
        decay = 0.0
    else:
        peaks = [
            np.abs(swing[(a <= motion.t) & (motion.t < b)]).max() for a, b in itertools.pairwise(passages[:9])
        ]
        decay = -float(np.polyfit(0.5 * damped * np.arange(8), np.log(peaks), 1)[0])
    omega = np.hypot(2.0 * np.pi / damped, decay)
    assert found.period == pytest.approx(2.0 * np.pi / omega, rel=0.005)
    assert found.damping_ratio == pytest.approx(decay / omega, rel=0.005, abs=1e-6)


@pytest.mark.parametrize(
    ("equation", "values", "reason"),
    [
        ("z'' - k*z = 0", [1.0], "does not pull it back"),
        ("z'' + c*z' + f*w = 0; w' = z' - w", [50.0, 1.0], "no one level of rest"),
        ("z'' + c*z' + k*z + f*w = 0; w' = z' - w", [50.0, 1.0, 1.0], "creeps back"),
        ("z'' - k*z + f*w = 0; w' = z' - w", [9.0, 1.0], "is not stable"),
        ("z'' + f*sign(z) + k*z = 0", [0.1, 1.0], "jumps at rest"),
        ("z'' + c*z' = g", [0.1, 1.0], "no one level of rest"),
    ],
)
def test_where_there_is_no_swing(equation: str, values: list[float], reason: str) -> None:
    found = small_swing(Law("mine", equation), values, 0.0)
    assert isinstance(found, NoSwing)
    assert reason in found.reason


def test_dry_friction_leaves_level_and_period() -> None:
    """It jumps with the velocity alone, so that only the damping of small swings has no bound."""
    found = small_swing(Law("mine", "z'' + f*sign(z') + c*z' + k*z = g"), [0.1, 0.2, 4.0, 2.0], 0.0)
    assert isinstance(found, SmallSwing)
    assert found.z == pytest.approx(0.5, abs=1e-9)
    assert found.period == pytest.approx(np.pi)
    assert found.damping_ratio == np.inf
