"""De Paula's Van der Pol-like law [D, eq. 5.12].

z'' + 2 alpha (z^2 - 2 z) z' + omega^2 z = g0. The damping 2 alpha ((z - 1)^2 - 1) is a parabola
about z = 1, so the law takes another form when the height is shifted or scaled: it holds for
z = (height - shift)/scale. Two things are fixed by convention, since no record can tell them: the
time unit is 1 s, and the scale is positive (the law turns into itself under z -> 2 - z).

Where a motion is so small that the damping hardly changes in its course, only the damping at rest
can be known, and alpha, shift and scale are tied to each other: the fit names that direction.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from reduced_models.laws.law import Law, SwingForm
from reduced_models.records.first_guesses import FirstGuesses
from reduced_models.records.quadratic_damping import quadratic_damping

_UNEXPLAINED = 0.3
"""Share of the record that its quadratic damping may leave over before it says nothing."""
_SPREAD = 0.1  # of the start values, in the size of the damping
_LEAST = 1e-3  # of curvature and depth of a damping, in its size


def _start(guesses: FirstGuesses, random: np.random.Generator, count: int) -> dict[str, np.ndarray]:
    omega = guesses.frequencies(random, count)
    level = guesses.levels(random, count)
    # Twice the decay is the damping 2 alpha ((level - 1)^2 - 1), where that is positive.
    shape = np.maximum(np.abs((level - 1.0) ** 2 - 1.0), 0.1)
    alpha = guesses.decays(random, count) / shape
    return {"alpha": alpha, "omega": omega, "g0": omega**2 * level}


def _swing_start(
    time: np.ndarray,
    swing: np.ndarray,
    guesses: FirstGuesses,
    random: np.random.Generator,
    count: int,
) -> dict[str, np.ndarray] | None:
    """Start values of the quadratic damping, from its weak form."""
    found = quadratic_damping(time, swing, guesses.period)
    if not found.unexplained < _UNEXPLAINED or not found.stiffness > 0.0:
        return None
    size = float(np.abs(found.damping).sum())
    c0, c1, c2 = found.damping[:, None] + _SPREAD * size * random.normal(size=(3, count))
    k = found.stiffness * np.exp(random.uniform(-_SPREAD, _SPREAD, count))
    return {"c0": c0, "c1": c1, "c2": c2, "k": k, "f": np.full(count, found.force)}


def _mapped(swing: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The law whose damping is that quadratic one.

    With z = p + q u the damping 2 alpha (z^2 - 2 z) is c0 + c1 u + c2 u^2 where c2 = 2 alpha q^2,
    c1 = 4 alpha q (p - 1), c0 = 2 alpha ((p - 1)^2 - 1), so 2 alpha = c1^2/(4 c2) - c0: a parabola
    that opens upwards and is negative at its vertex. Another one is replaced by one with the same
    damping at rest, and nearly its slope there.
    """
    c0, c1, c2, k, f = (swing[name] for name in ("c0", "c1", "c2", "k", "f"))
    size = np.abs(c0) + np.abs(c1) + np.abs(c2)
    least = _LEAST * size
    depth = c0 + least
    steepest = np.where(
        depth > 0.0, c1**2 / (4.0 * np.maximum(np.abs(depth), _LEAST * least)), np.inf
    )
    c2 = np.maximum(np.minimum(np.maximum(c2, least), steepest), _LEAST * least)
    double_alpha = np.maximum(c1**2 / (4.0 * c2) - c0, np.maximum(-c0, least))
    q = np.sqrt(c2 / double_alpha)
    p = 1.0 + np.where(c1 < 0.0, -1.0, 1.0) * np.sqrt(np.maximum(1.0 + c0 / double_alpha, 0.0))
    return {
        "alpha": 0.5 * double_alpha,
        "omega": np.sqrt(k),
        "g0": k * p + f * q,
        "shift": -p / q,
        "scale": 1.0 / q,
    }


VAN_DER_POL_LIKE = Law(
    name="van-der-pol-like",
    equation="z'' + 2*alpha*(z**2 - 2*z)*z' + omega**2*z = g0",
    start=_start,
    positive=("alpha", "omega"),
    units={"alpha": "1/s", "omega": "rad/s", "g0": "1/s^2"},
    mapped=True,
    swing_form=SwingForm(
        Law("quadratic damping", "z'' + (c0 + c1*z + c2*z**2)*z' + k*z = f", positive=("k",)),
        _swing_start,
        _mapped,
    ),
    source="[D, eq. 5.12]",
)
