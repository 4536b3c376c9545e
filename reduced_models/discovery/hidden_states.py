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


_STRAINS, _DISPLACEMENTS = np.geomspace(0.01, 1.0, 17)[:, None], np.geomspace(1e-5, 0.1, 33)[:, None]


class HiddenState(NamedTuple):
    """A kind of hidden state."""

    name: str
    rate_equations: str
    step: StateStep  # of each state; with three scales there are two, the second one times the third scale
    trial_scales: np.ndarray = _STRAINS  # (k, s), that are tried first
    scales: tuple[str, ...] = ("yielding",)
    force_variable: str = "w"  # the one variable of the rate equations that terms know
    in_periods: bool = False  # trial scales are times, in periods of the motion
    of_displacement: bool = False  # the state is a displacement, and not a strain

    def values_along_motion(self, time: np.ndarray, height: np.ndarray, scales: np.ndarray) -> np.ndarray:
        """Values (k, n) along a motion, for each of the scales (k, s)."""
        # The strain of these heights is the displacement.
        heights = np.exp(-height) if self.of_displacement else height
        first = _integrate_states(self.step, time, heights, scales[:, 0])
        if scales.shape[1] == 1:
            return first
        return np.asarray(first + scales[:, 2:] * _integrate_states(self.step, time, heights, scales[:, 1]))

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


def _pairs_of_strains() -> np.ndarray:
    strains = np.geomspace(0.01, 1.0, 6)
    pairs = [(a, b) for k, a in enumerate(strains) for b in strains[k + 1 :]]
    return np.array([(*pair, fraction) for pair in pairs for fraction in (0.5, 2.0)])


_YIELDING = "-(z' + Abs(z')*Abs({0})*{0}/{1}**2)/z"
HIDDEN_STATES = (
    HiddenState("yielding strain", "w' = " + _YIELDING.format("w", "yielding"), _step_yielding_state),
    HiddenState(
        "strain that yields as in Dahl's model", "w' = -(z' + Abs(z')*w/yielding)/z", _step_dahl_state
    ),
    HiddenState(
        "relaxing strain",
        "w' = -z'/z - w/relaxation",
        _step_relaxing_state,
        np.geomspace(0.02, 20.0, 17)[:, None],
        ("relaxation",),
        in_periods=True,
    ),
    HiddenState(
        "two yielding strains",
        f"w' = {_YIELDING.format('w', 'yielding')}; q' = {_YIELDING.format('q', 'later')}",
        _step_yielding_state,
        _pairs_of_strains(),
        ("yielding", "later", "share"),
        "(w + share*q)",
    ),
)
DAMPER_STATES = (
    HiddenState(
        "displacement that yields",
        "w' = z' - Abs(z')*Abs(w)*w/yielding**2",
        _step_yielding_state,
        _DISPLACEMENTS,
        of_displacement=True,
    ),
    HiddenState(
        "displacement that yields as in Dahl's model",
        "w' = z' - Abs(z')*w/yielding",
        _step_dahl_state,
        _DISPLACEMENTS,
        of_displacement=True,
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
