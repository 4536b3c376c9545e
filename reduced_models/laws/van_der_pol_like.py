"""De Paula's Van der Pol-like law [D, eq. 5.12].

The equation is z'' + 2 alpha (z^2 - 2 z) z' + omega^2 z = g0. The damping 2 alpha ((z - 1)^2 - 1) is a
parabola about z = 1, so the law changes its form when the height is shifted or scaled. The law holds for z =
(height - shift)/scale. Two conventions are needed, since no record can determine them: the time unit is 1 s,
and the scale is positive (the law is invariant under z -> 2 - z).

For a motion so small that the damping hardly varies, only the damping at rest is determined, and
alpha, shift and scale are fully correlated. The fit then reports this undetermined direction.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from granular.shared.array_types import Float
from reduced_models.laws.law import Law
from reduced_models.records.first_guesses import FirstGuesses

_MAXIMUM_UNEXPLAINED = 0.3
"""The fitted quadratic damping is used if it leaves at most this fraction of the accelerations unexplained.
"""
_SPREADS = 0.003, 0.1
"""Random spreads of the first and of the last start values, relative to the damping."""
_MINIMUM_CURVATURE = 1e-3  # minimum curvature and depth of a damping, relative to its size
_TEST_FUNCTION_WIDTH = 0.6  # half-width of a test function, in periods
_TEST_FUNCTION_POWER = 4  # of the test function (1 - s^2)^4
_MAXIMUM_TEST_FUNCTIONS = 512


def _draw_start_values(
    guesses: FirstGuesses, random: np.random.Generator, count: int
) -> dict[str, np.ndarray]:
    """Draw start values about the fitted quadratic damping of the motion, or about first guesses."""
    displacement = (guesses.heights - guesses.rest) / guesses.amplitude
    result = fit_quadratic_damping(guesses.time, displacement, guesses.period)
    if not result.unexplained < _MAXIMUM_UNEXPLAINED or not result.stiffness > 0.0:
        return _draw_start_values_about_guesses(guesses, random, count)
    spread = np.geomspace(*_SPREADS, count)
    size = float(np.abs(result.damping).sum())
    damping = result.damping[:, None] + spread * size * random.normal(size=(3, count))
    k = result.stiffness * np.exp(spread * random.uniform(-1.0, 1.0, count))
    return parameters_from_quadratic_damping(guesses, damping, k, result.force)


def _draw_start_values_about_guesses(
    guesses: FirstGuesses, random: np.random.Generator, count: int
) -> dict[str, np.ndarray]:
    scale = np.exp(random.uniform(-1.5, 1.5, count))  # size of the law's unit of z, in amplitudes
    origin = random.uniform(-2.0, 4.0, count)  # equilibrium, in scales
    level = origin + (guesses.draw_rest_levels(random, count) - guesses.rest) / (guesses.amplitude * scale)
    omega = guesses.draw_frequencies(random, count)
    # If it is positive, the damping 2 alpha ((level - 1)^2 - 1) is twice the decay rate.
    shape = np.maximum(np.abs((level - 1.0) ** 2 - 1.0), 0.1)
    return {
        "alpha": guesses.draw_decay_rates(random, count) / shape,
        "omega": omega,
        "g0": omega**2 * level,
        "shift": guesses.rest - guesses.amplitude * scale * origin,
        "scale": guesses.amplitude * scale,
    }


def parameters_from_quadratic_damping(
    guesses: FirstGuesses, damping: Float[np.ndarray, "3 n"], k: Float[np.ndarray, "n"], f: float
) -> dict[str, np.ndarray]:
    """Convert damping c0 + c1 u + c2 u^2 to parameters; u is the displacement divided by the amplitude."""
    # z = p + q u turns the damping 2 alpha (z^2 - 2 z) into c0 + c1 u + c2 u^2 with c2 = 2 alpha q^2, c1 = 4
    # alpha q (p - 1), so 2 alpha = c1^2/(4 c2) - c0: a parabola that opens upwards and is negative at its
    # vertex. Other parabolas are replaced by one of this kind with the same damping at rest.
    c0, c1, c2 = damping
    size = np.abs(damping).sum(axis=0)
    minimum = _MINIMUM_CURVATURE * size
    depth = c0 + minimum
    steepest = np.where(
        depth > 0.0, c1**2 / (4.0 * np.maximum(np.abs(depth), _MINIMUM_CURVATURE * minimum)), np.inf
    )
    c2 = np.maximum(np.minimum(np.maximum(c2, minimum), steepest), _MINIMUM_CURVATURE * minimum)
    double_alpha = np.maximum(c1**2 / (4.0 * c2) - c0, np.maximum(-c0, minimum))
    q = np.sqrt(c2 / double_alpha)
    p = 1.0 + np.where(c1 < 0.0, -1.0, 1.0) * np.sqrt(np.maximum(1.0 + c0 / double_alpha, 0.0))
    line = {"shift": guesses.rest - guesses.amplitude * p / q, "scale": guesses.amplitude / q}
    given = {name: np.full_like(k, guesses.given[name]) for name in line if name in guesses.given}
    if given:
        line |= given
        p, q = (guesses.rest - line["shift"]) / line["scale"], guesses.amplitude / line["scale"]
        shape = np.stack([(p - 1.0) ** 2 - 1.0, 2.0 * q * (p - 1.0), q**2])
        double_alpha = np.maximum((shape * damping).sum(axis=0) / (shape**2).sum(axis=0), minimum)
    return {"alpha": 0.5 * double_alpha, "omega": np.sqrt(k), "g0": k * p + f * q, **line}


VAN_DER_POL_LIKE = Law(
    name="van-der-pol-like",
    equation="z'' + 2*alpha*(z**2 - 2*z)*z' + omega**2*z = g0; height = shift + scale*z",
    start=_draw_start_values,
    positive=("alpha", "omega", "scale"),
    units={"alpha": "1/s", "omega": "rad/s", "g0": "1/s^2", "shift": "m", "scale": "m"},
    source="[D, eq. 5.12]",
)


class QuadraticDamping(NamedTuple):
    """u'' + (c0 + c1 u + c2 u^2) u' + stiffness u = force."""

    damping: Float[np.ndarray, "3"]  # c0, c1, c2
    stiffness: float
    force: float
    unexplained: float  # residual fraction of the squared weak-form accelerations


def fit_quadratic_damping(
    time: Float[np.ndarray, "n"], u: Float[np.ndarray, "n"], period: float
) -> QuadraticDamping:
    """Fit quadratic damping [1/s] and a linear spring [1/s^2] to a normalised motion."""
    # Weak form (Messenger & Bortz 2021, doi:10.1137/20M1343166): height-dependent damping is a total
    # derivative, so that test functions take all derivatives and the coefficients follow from linear least
    # squares.
    half = min(_TEST_FUNCTION_WIDTH * period, 0.3 * float(time[-1] - time[0]))
    count = int(np.clip(8 * (time[-1] - time[0]) / half, 16, _MAXIMUM_TEST_FUNCTIONS))
    centres = np.linspace(time[0] + half, time[-1] - half, count)
    powers = np.stack([u, u**2 / 2.0, u**3 / 3.0, -u, np.ones_like(u)])
    rows, targets = np.empty((count, 5)), np.empty(count)
    for k, centre in enumerate(centres):
        inside = slice(*np.searchsorted(time, (centre - half, centre + half)))
        test_function, slope, curvature = _test_function_and_two_derivatives((time[inside] - centre) / half)
        weights = np.stack([slope / half, slope / half, slope / half, test_function, test_function])
        rows[k] = np.trapezoid(weights * powers[:, inside], time[inside], axis=1)
        targets[k] = np.trapezoid(curvature / half**2 * u[inside], time[inside])
    size = np.maximum(np.abs(rows).max(axis=0), 1e-300)
    result = np.linalg.lstsq(rows / size, targets, rcond=1e-12)[0] / size
    residual = targets - rows @ result
    unexplained = float(residual @ residual / max(float(targets @ targets), 1e-300))
    return QuadraticDamping(result[:3], float(result[3]), float(result[4]), unexplained)


def _test_function_and_two_derivatives(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the test function (1 - s^2)^p and its first two derivatives."""
    p, rest = _TEST_FUNCTION_POWER, np.maximum(1.0 - s * s, 0.0)
    slope = -2.0 * p * s * rest ** (p - 1)
    curvature = 2.0 * p * rest ** (p - 2) * (2.0 * (p - 1) * s * s - rest)
    return rest**p, slope, curvature
