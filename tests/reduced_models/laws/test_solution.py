"""Solutions of any length: their work is that of the record, and stiff laws take an implicit solver."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from reduced_models import Law
from reduced_models.laws import solution
from reduced_models.laws.law import law_from_text
from reduced_models.laws.solution import Solution, solve_law

STIFF = "z'' + k*z + c*w = 0; w' = r*(z' - w)"
BOUC_WEN = "z'' + k*z + f*w = 0; w' = r*(z' - s*Abs(z')*w - (1 - s)*z'*Abs(w))"
OMEGA, COUPLING = 8.0 * np.pi, 0.4


@pytest.fixture
def solvers(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Kind of the solver of each call: True where it was implicit."""
    calls: list[bool] = []
    make = solution._adaptive_solver

    def follow(*given: Any, implicit: bool) -> Callable[..., Any]:
        calls.append(implicit)
        return make(*given, implicit=implicit)

    monkeypatch.setattr(solution, "_adaptive_solver", follow)
    return calls


def solve(text: str, time: np.ndarray, z0: float = 1.0, **values: float) -> Solution:
    law = law_from_text(text)
    return solve_law(law, time, z0, 0.0, [values[name] for name in law.parameters], 1.0)


@pytest.mark.parametrize("rate", [1e5, 1e7])
def test_a_fast_rate_beside_a_slow_swing(solvers: list[bool], rate: float) -> None:
    """Against the closed form, of 4 Hz."""
    time = np.linspace(0.0, 20.0, 2000)
    found = solve(STIFF, time, k=OMEGA**2, c=COUPLING, r=rate)
    matrix = np.array([[0.0, 1.0, 0.0], [-(OMEGA**2), 0.0, -COUPLING], [0.0, rate, -rate]])
    rates, shapes = np.linalg.eig(matrix)
    modes = shapes[0] * np.linalg.solve(shapes, [1.0, 0.0, 0.0])
    exact = (np.exp(np.outer(time, rates)) @ modes).real
    np.testing.assert_allclose(found.z, exact, atol=1e-9)
    assert solvers == [False, True, True]


def test_a_relaxation_oscillation_agrees_with_scipy(solvers: list[bool]) -> None:
    from scipy.integrate import solve_ivp

    def rates(_: float, state: np.ndarray) -> list[float]:
        z, v = state
        return [v, 1e3 * (1.0 - z**2) * v - z]

    time = np.linspace(0.0, 1500.0, 500)
    found = solve("z'' - mu*(1 - z**2)*z' + z = 0", time, 2.0, mu=1e3)
    exact = solve_ivp(rates, (0.0, 1500.0), [2.0, 0.0], "Radau", time, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.z, exact.y[0], atol=1e-5)
    assert solvers[-1]


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("z'' + mu*tanh(z'/v) + k*z = 0", {"mu": 1e-3, "v": 1e-4, "k": 600.0}),
        (BOUC_WEN, {"k": 600.0, "f": 1e-3, "r": 10.0, "s": 0.9}),
    ],
)
def test_corners_are_no_stiffness(solvers: list[bool], text: str, values: dict[str, float]) -> None:
    found = solve(text, np.linspace(0.0, 60.0, 9000), **values)
    assert found.ending == "complete"
    assert len(solvers) > 1
    assert not any(solvers)


def test_corners_between_stiff_stretches_are_left_to_the_explicit_solver(solvers: list[bool]) -> None:
    found = solve(BOUC_WEN, np.linspace(0.0, 20.0, 200), k=600.0, f=1e-3, r=1e3, s=0.9)
    assert found.ending == "complete"
    assert sum(solvers) == 1
    assert not solvers[-1]


def test_a_long_record_is_its_parts(solvers: list[bool]) -> None:
    """The state is carried from call to call, with the step, under a driving force."""
    time = np.linspace(0.0, 300.0, 30001)
    drive = np.sin(1.3 * time)
    law = Law("driven", "z'' + c*z' + k*z + b*z**3 = force", inputs=("force",))
    values = (0.1, 1.0, 0.3)
    whole = solve_law(law, time, 1.0, 0.0, values, 1.0, [drive])
    assert len(solvers) == 15
    half = slice(15000, None)
    z, v = whole.z[15000], whole.velocity[15000]
    second = solve_law(law, time[half], z, v, values, 1.0, [drive[half]])
    np.testing.assert_allclose(second.z, whole.z[half], atol=1e-7)


@pytest.mark.parametrize(
    ("text", "last"),
    [("z'' + mu*sign(z') + k*z = 0", 1.3), ("z'' = exp(mu*z) + 0*k", 1.4), ("z'' = mu*log(z) - 3*k", 1.4)],
)
def test_work_without_end_is_broken_off(solvers: list[bool], text: str, last: float) -> None:
    """Sticking by a sign, a singularity, and where the law is not defined."""
    time = np.linspace(0.0, 40.0, 2000)
    found = solve(text, time, mu=30.0 if "sign" in text else 1.0, k=600.0 if "sign" in text else 1.0)
    assert found.ending == "steps"
    assert len(solvers) <= 12
    reached = np.isfinite(found.z)
    assert 0.5 < time[reached][-1] < last
