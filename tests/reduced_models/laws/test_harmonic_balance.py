"""Harmonic cycles against closed forms of friction and dashpots."""

from __future__ import annotations

import numpy as np
import pytest

from reduced_models.laws.law import Law
from reduced_models.laws.linearization import equation_rates, harmonic_cycles, law_rates

SIZES = np.array([0.5, 0.1])
OMEGA, LAM, FRICTION, LEVEL = 1.3, 0.05, 0.02, 0.7
RATIOS = LAM / OMEGA + 2.0 * FRICTION / (np.pi * OMEGA**2 * SIZES)


@pytest.mark.parametrize("dry", ["sign(z')", "tanh(1e6*z')"])
def test_friction_and_a_dashpot(dry: str) -> None:
    law = Law("mine", f"z'' + f*{dry} + 2*lam*z' + omega**2*(z - rest) = 0")
    known = {"f": FRICTION, "lam": LAM, "omega": OMEGA, "rest": LEVEL}
    values = [known[name] for name in law.parameters]
    for rates in (law_rates(law, values), equation_rates(law.sympy_equation(known))):
        found = harmonic_cycles(rates, 0, SIZES, LEVEL + 0.01, 1.0)
        np.testing.assert_allclose(found.damping_ratio, RATIOS, rtol=1e-4)
        np.testing.assert_allclose(found.frequency, OMEGA, rtol=1e-9)
        np.testing.assert_allclose(found.centre, LEVEL, rtol=1e-9)
        dashpot = 0.5 * np.pi * SIZES * OMEGA * LAM
        np.testing.assert_allclose(found.equivalent_friction(SIZES) - dashpot, FRICTION, rtol=1e-4)


def test_many_laws_at_once() -> None:
    """Values of parameters may be arrays; each cycle has its own."""
    law = Law("mine", "z'' + 2*lam*z' + k*z + b*z**3 = 0")
    lams, spring = np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0])
    together = harmonic_cycles(law_rates(law, (lams, spring, 0.5)), 0, SIZES[:, None], np.zeros(3), 1.0)
    assert together.damping.shape == (2, 3)
    for row, size in enumerate(SIZES):
        for k in range(3):
            alone = harmonic_cycles(law_rates(law, (lams[k], spring[k], 0.5)), 0, size, 0.0, 1.0)
            assert together.damping_ratio[row, k] == pytest.approx(alone.damping_ratio[0])
            # The first harmonic of a cubic spring is 3/4 b A^2 (Krylov & Bogoliubov).
            assert alone.stiffness[0] == pytest.approx(spring[k] + 0.375 * size**2)
