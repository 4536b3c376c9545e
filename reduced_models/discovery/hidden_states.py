"""Hidden states that a bed may carry, and their values along a recorded motion.

Each is a strain of the bed that starts at zero with the record: the logarithmic strain dz/z, but
for what it loses by yielding or in time. Inner scales say when that happens. With the strain x of a
step,

    yielding:  w' = -(z' + |z'| |w| w/yield^2)/z
    Dahl:      w' = -(z' + |z'| w/yield)/z            (Dahl 1968: it yields from the start on)
    relaxing:  w' = -z'/z - w/relaxation              (a Maxwell element: one relaxing mode)

are solved exactly from sample to sample, on which the speed z'/z is taken as constant.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from reduced_models.discovery.terms import INPUT

StateStep = Callable[[np.ndarray, float, float, np.ndarray], np.ndarray]
"""Map from the state (k,), the step's strain -d(log z) and its duration to the next state, for each of
the scales (k,)."""
_NEAR_ONE = 1.0 - 1e-12


class HiddenState(NamedTuple):
    """A kind of hidden state."""

    name: str
    rate_equations: str
    force_variable: str  # the one variable of theirs that terms know
    scales: tuple[str, ...]
    values_along_motion: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    trial_scales: Callable[[float], np.ndarray]  # from a period [s] to the scales (k, s) that are tried first

    def substitute_into(self, equation: str) -> str:
        """Equation with the state's force variable in place of the input, and the state's rate."""
        forces = re.sub(rf"\b{INPUT}\b", self.force_variable, equation)
        return f"{forces}; {self.rate_equations}"


def _step_yielding_state(state: np.ndarray, strain: float, _: float, scale: np.ndarray) -> np.ndarray:
    """Ds = dx (1 - |s| s sign(dx)/e^2): a tangent back to zero, a hyperbolic one from there on."""
    sign = 1.0 if strain >= 0.0 else -1.0
    along, distance = sign * state / scale, abs(strain) / scale
    since = np.where(
        along < 0.0, np.arctan(np.minimum(along, 0.0)), np.arctanh(np.clip(along, 0.0, _NEAR_ONE))
    )
    reached = since + distance
    return np.asarray(
        sign * scale * np.where(reached < 0.0, np.tan(np.minimum(reached, 0.0)), np.tanh(reached))
    )


def _step_dahl_state(state: np.ndarray, strain: float, _: float, scale: np.ndarray) -> np.ndarray:
    end = scale if strain >= 0.0 else -scale
    return np.asarray(end + (state - end) * np.exp(-abs(strain) / scale))


def _step_relaxing_state(state: np.ndarray, strain: float, step: float, scale: np.ndarray) -> np.ndarray:
    saved = step / scale
    return np.asarray(state * np.exp(-saved) - strain * np.expm1(-saved) / saved)


def _integrate_states(step: StateStep, time: np.ndarray, height: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Values (k, n) of a state with one scale (k,)."""
    strains, steps = -np.diff(np.log(height)), np.diff(time)
    values = np.zeros((len(time), len(scale)))
    for k, (strain, value) in enumerate(zip(strains.tolist(), steps.tolist(), strict=True)):
        values[k + 1] = step(values[k], strain, value, scale)
    return values.T


def _one_scale_evaluator(step: StateStep) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    return lambda time, height, scales: _integrate_states(step, time, height, scales[:, 0])


def _two_scale_values(time: np.ndarray, height: np.ndarray, scales: np.ndarray) -> np.ndarray:
    first, second = (_integrate_states(_step_yielding_state, time, height, scales[:, k]) for k in (0, 1))
    return np.asarray(first + scales[:, 2:] * second)


def _trial_yield_strains(_: float) -> np.ndarray:
    return np.geomspace(0.01, 1.0, 17)[:, None]


def _trial_yield_strain_pairs(_: float) -> np.ndarray:
    strains = np.geomspace(0.01, 1.0, 6)
    pairs = [(a, b) for k, a in enumerate(strains) for b in strains[k + 1 :]]
    return np.array([(*pair, fraction) for pair in pairs for fraction in (0.5, 2.0)])


def _trial_relaxation_times(period: float) -> np.ndarray:
    return period * np.geomspace(0.02, 20.0, 17)[:, None]


_YIELDING = "-(z' + Abs(z')*Abs({0})*{0}/{1}**2)/z"

HIDDEN_STATES = (
    HiddenState(
        "yielding strain",
        "w' = " + _YIELDING.format("w", "yielding"),
        "w",
        ("yielding",),
        _one_scale_evaluator(_step_yielding_state),
        _trial_yield_strains,
    ),
    HiddenState(
        "strain that yields as in Dahl's model",
        "w' = -(z' + Abs(z')*w/yielding)/z",
        "w",
        ("yielding",),
        _one_scale_evaluator(_step_dahl_state),
        _trial_yield_strains,
    ),
    HiddenState(
        "relaxing strain",
        "w' = -z'/z - w/relaxation",
        "w",
        ("relaxation",),
        _one_scale_evaluator(_step_relaxing_state),
        _trial_relaxation_times,
    ),
    HiddenState(
        "two yielding strains",
        f"w' = {_YIELDING.format('w', 'yielding')}; q' = {_YIELDING.format('q', 'later')}",
        "(w + share*q)",
        ("yielding", "later", "share"),
        _two_scale_values,
        _trial_yield_strain_pairs,
    ),
)


def _displacement_evaluator(step: StateStep) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    # The strain of these heights is the displacement.
    return lambda time, height, scales: _integrate_states(step, time, np.exp(-height), scales[:, 0])


def _trial_yield_displacements(_: float) -> np.ndarray:
    return np.geomspace(1e-5, 0.1, 33)[:, None]


DAMPER_STATES = (
    HiddenState(
        "displacement that yields",
        "w' = z' - Abs(z')*Abs(w)*w/yielding**2",
        "w",
        ("yielding",),
        _displacement_evaluator(_step_yielding_state),
        _trial_yield_displacements,
    ),
    HiddenState(
        "displacement that yields as in Dahl's model",
        "w' = z' - Abs(z')*w/yielding",
        "w",
        ("yielding",),
        _displacement_evaluator(_step_dahl_state),
        _trial_yield_displacements,
    ),
)
"""Hidden states of a damper on a stroke about zero, in m: that of Bouc and Wen, and Dahl's."""


class ScaledHiddenState(NamedTuple):
    """A hidden state with numbers for its scales."""

    kind: HiddenState
    scales: tuple[float, ...]

    def substitute_into(self, equation: str) -> str:
        """Equation with the hidden state for its input, the state's rate, and numbers for the scales."""
        text = self.kind.substitute_into(equation)
        for name, value in zip(self.kind.scales, self.scales, strict=True):
            text = re.sub(rf"\b{name}\b", f"{value:.4g}", text)
        return text
