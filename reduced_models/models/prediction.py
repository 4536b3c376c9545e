"""Predictions of a model: decays, cycles and driven responses, and their uncertainty.

Forces and energies are per kilogram of moving mass; multiplied by the piston's mass they are in newtons
and joules. Cycles are harmonic; see `reduced_models.laws.linearization`.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from granular.records.record import DRAWN_UNITS, PistonRecord
from granular.shared.array_types import Float
from granular.shared.errors import InputError, quote
from reduced_models.laws.equation import compile_rates
from reduced_models.laws.law import Law
from reduced_models.laws.linearization import (
    NoOscillationReason,
    Rates,
    make_rates_of_law,
    mean_force_stiffness_and_damping_of_cycles,
    shifted_centres_stiffness_and_damping,
    small_oscillation,
    solve_harmonic_balance,
)
from reduced_models.models.at_rest import HarmonicCycle
from reduced_models.models.fitted_law import FittedLaw
from reduced_models.records.inputs import TIME

if TYPE_CHECKING:
    from matplotlib.axes import Axes


# Five decades in steps of 5 %; roots between grid points are interpolated in logarithms.
_AMPLITUDES = 240
_PER_PERIOD = 64
_OBSERVATION_OR_RATE = re.compile(r"\s*[^\W\d]\w*'?\s*=")


class SteadyAmplitudes(NamedTuple):
    """Steady amplitudes under a harmonic force, from describing functions."""

    frequency: Float[np.ndarray, "n"]  # angular [rad/s]
    low: Float[np.ndarray, "n"]  # [m]
    high: Float[np.ndarray, "n"]  # [m]


def initial_state(model: FittedLaw) -> Float[np.ndarray, "s"]:
    """Return the states at the record's start: height [m], velocity [m/s], then hidden states."""
    _refuse_prescribed_stroke(model)
    hidden = [model.hidden.get(name, 0.0) for name in model.law.hidden]
    return np.array([*model.initial, *hidden], dtype=np.float64)


def state_rates(
    model: FittedLaw,
    t: float,
    state: Float[np.ndarray, "s"],
    inputs: Mapping[str, float | Callable[[float], float]],
) -> Float[np.ndarray, "s"]:
    """Return the rates of a state (s,), or of k states (s, k), at a time [s]."""
    _refuse_prescribed_stroke(model)
    law, states = model.law, np.asarray(state, dtype=np.float64)
    if len(states) != 2 + len(law.hidden):
        names = ", ".join(("height", "velocity", *law.hidden))
        raise InputError(f"the state has {len(states)} entries; give {2 + len(law.hidden)}: {names}")
    known = {TIME: t, **inputs}
    missing = [name for name in law.inputs if name not in known]
    if missing:
        raise InputError(
            f"the law {quote(law.name)} has the input {quote(missing[0])}; pass inputs={{"
            f"{quote(missing[0])}: a number or a function of the time}}, with solve_ivp by args=(inputs,)"
        )
    drive = [value(t) if callable(value) else value for value in (known[name] for name in law.inputs)]
    rates = compile_rates(law.equation, law.inputs, "numpy")
    slopes = (states[1], *rates(*states, *drive, *model.all_parameters.values()))
    return np.stack([np.broadcast_to(slope, states.shape[1:]) for slope in slopes])


def _refuse_prescribed_stroke(model: FittedLaw) -> None:
    if model.law.prescribed:
        raise InputError(
            f"the law {quote(model.law.name)} describes the {model.observation or 'force'} along a "
            "prescribed stroke, not a motion; use .simulate_signal(record)"
        )


def free_decay(model: FittedLaw, amplitude: float, periods: float = 10.0) -> PistonRecord:
    """Return the motion of a piston released at an amplitude [m] above equilibrium."""
    if not 0.0 < periods < math.inf:
        raise InputError(f"periods = {quote(periods)}; give a finite number above 0")
    height, period = _rest_height_and_period(model)
    time = np.linspace(0.0, periods * period, max(2, math.ceil(periods * _PER_PERIOD) + 1))
    still = {name: np.zeros_like(time) for name in model.law.inputs}
    return model.simulate(time, height + amplitude, 0.0, still)


def harmonic_cycle(model: FittedLaw, amplitude: float, frequency: float | None = None) -> HarmonicCycle:
    """Return a harmonic cycle of a model with zero inputs; ``frequency`` is in rad/s."""
    if not amplitude > 0.0:
        raise InputError(f"amplitude = {quote(amplitude)} m; give a value above 0")
    _refuse_further_coordinates(model)
    if frequency is not None and not 0.0 < frequency < math.inf:
        raise InputError(f"frequency = {quote(frequency)} rad/s; give a value above 0")
    height, period = _rest_height_and_period(model)
    result = solve_harmonic_balance(
        _make_model_rates(model),
        len(model.law.hidden),
        amplitude,
        height,
        2.0 * math.pi / period if frequency is None else frequency,
        free=frequency is None,
    )
    omega, stiffness, damping = (float(value[0]) for value in result[1:])
    if not math.isfinite(stiffness):
        raise InputError(
            f"a cycle of amplitude {amplitude:g} m leaves the range in which the law "
            f"{quote(model.law.name)} is defined; give a smaller amplitude"
        )
    if frequency is None and stiffness <= 0.0:
        raise InputError(
            f"the law {quote(model.law.name)} has no stiffness at an amplitude of "
            f"{amplitude:g} m; "
            "give the frequency, or a smaller amplitude"
        )
    centre = float(result.centre[0])
    energy = math.pi * amplitude**2 * omega * damping
    return HarmonicCycle(amplitude, omega, centre, stiffness, damping, energy)


def frequency_response(
    model: FittedLaw, force: float, frequencies: np.ndarray, largest: float | None = None
) -> SteadyAmplitudes:
    """Return steady amplitudes [m]; ``force`` is in m/s^2, ``frequencies`` are in rad/s."""
    if not 0.0 < force < math.inf:
        raise InputError(f"force = {quote(force)} N/kg; give a value above 0")
    _refuse_further_coordinates(model)
    if largest is not None and not 0.0 < largest < math.inf:
        raise InputError(f"largest = {quote(largest)} m; give a value above 0")
    height, period = _rest_height_and_period(model)
    omega = np.asarray(frequencies, dtype=np.float64)
    if omega.ndim != 1 or not ((omega > 0.0) & (omega < math.inf)).all():
        raise InputError("frequencies must be an array (n,) of angular frequencies above 0")
    edges = model.domain.get("height", (height, height))
    far = largest or 10.0 * max(abs(edge - height) for edge in edges)
    amplitude = far * np.logspace(-5.0, 0.0, _AMPLITUDES)
    rates, hidden = _make_model_rates(model), len(model.law.hidden)
    centre = np.full_like(amplitude, height)
    for _ in range(4):
        centre, *_ = shifted_centres_stiffness_and_damping(
            rates, hidden, amplitude, centre, np.full_like(amplitude, 2 * math.pi / period)
        )
    _, stiffness, damping = mean_force_stiffness_and_damping_of_cycles(
        rates, hidden, amplitude[:, None], centre[:, None], omega[None, :]
    )
    # Steady cycle: the force balances stiffness minus inertia in phase, and damping in quadrature.
    needed = amplitude[:, None] * np.hypot(stiffness - omega**2, damping * omega)
    low, high = np.full((2, len(omega)), np.nan)
    for k in range(len(omega)):
        roots = _zero_crossing_positions(np.log(amplitude), np.log(needed[:, k] / force))
        if len(roots):
            low[k], high[k] = math.exp(roots[0]), math.exp(roots[-1])
    return SteadyAmplitudes(omega, low, high)


def law_with_force_input(law: Law, name: str = "drive") -> Law:
    """Add a force per kilogram to a law, as an input in the units of z''.

    Parameters
    ----------
    law : Law
        Law with the coordinate ``z`` that does not contain this input.
    name : str
        Name of the input, a column of the fitted records; do not use ``"t"``, which is the time.

    Returns
    -------
    Law
        Law in which z'' minus the input replaces z'' in the first equation of motion that contains z''.
        Parameters and their units are unchanged. The new law has no function for start values.

    Raises
    ------
    InputError
        If the law already uses the name, has no ``z''`` or has a prescribed stroke, or the name
        is not allowed for an input, such as ``"z"``, ``"pi"`` and ``"1x"``.

    Examples
    --------
    >>> from reduced_models import law_with_force_input, law_named
    >>> law_with_force_input(law_named("linear"), "force").equation
    "(z'' - force) + 2*lam*z' + omega**2*z = g0"
    """
    if name in (*law.parameters, *law.hidden, *law.inputs):
        raise InputError(f"the law {quote(law.name)} already uses the name {quote(name)}; give another name")
    if law.prescribed:
        raise InputError(
            f"the law {quote(law.name)} is for a prescribed stroke, which a force cannot drive; "
            "give a law of motion"
        )
    line = law.parsed_equation.line
    push = name if line is None else f"{name}/({line[1]})"  # in the coordinate of the law's text
    statements = law.equation.split(";")
    for k, statement in enumerate(statements):
        # Observations refer to the total acceleration.
        if "z''" in statement and not _OBSERVATION_OR_RATE.match(statement):
            statements[k] = statement.replace("z''", f"(z'' - {push})")
            break
    text = ";".join(statements)
    changes: dict[str, Any] = {"start": None, "inputs": (*law.inputs, name)}
    driven = dataclasses.replace(law, name=f"{law.name}, driven", equation=text, **changes)
    _ = driven.parsed_equation  # raises an error for an invalid name
    return driven


def _refuse_further_coordinates(model: FittedLaw) -> None:
    if model.law.other_coordinates:
        raise InputError(
            f"the law {quote(model.law.name)} has several coordinates, but a harmonic cycle needs one; use "
            "its modes, .at_rest and .faster_modes, or .simulate"
        )


def _rest_height_and_period(model: FittedLaw) -> tuple[float, float]:
    """Return equilibrium height [m] and period [s] of small oscillations."""
    if model.at_rest is None:
        raise InputError(
            f"the law {quote(model.law.name)} has no equilibrium near its record, so a small oscillation "
            "is not defined; fit another law"
        )
    return model.at_rest.height, model.at_rest.period


def _make_model_rates(model: FittedLaw) -> Rates:
    return make_rates_of_law(model.law, list(model.all_parameters.values()))


def _zero_crossing_positions(position: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Return the positions of zero crossings of a sampled function."""
    good = np.isfinite(value)
    position, value = position[good], value[good]
    at = np.flatnonzero(np.sign(value[1:]) != np.sign(value[:-1]))
    fraction = value[at] / (value[at] - value[at + 1])
    return np.asarray(position[at] + fraction * (position[at + 1] - position[at]))


M = TypeVar("M", bound=FittedLaw)
_STEP = 1e-3  # step of derivatives, in standard deviations
_STRAIGHT = 0.05  # maximum nonlinearity within a step, relative to the change
_ERROR = 1e-8  # upper bound of the solver's error, relative to the motion's size
_FIGURE_STEP = 0.01  # step of a parameter for derivatives of figures, in standard deviations
_MINIMUM_STEP = 1e-6  # relative to the parameter
_HELD = 1e-9  # relative standard deviation below which a parameter counts as fixed
_ROUNDS = 60  # tenfold reductions of the step before a direction is abandoned


class PredictionBand(NamedTuple):
    """A prediction with its confidence band."""

    time: Float[np.ndarray, "n"]  # [s]
    height: Float[np.ndarray, "n"]  # [m]
    low: Float[np.ndarray, "n"]  # [m], for the motion without noise
    high: Float[np.ndarray, "n"]  # [m]
    noise: float  # [m]
    confidence: float


class FasterMode(NamedTuple):
    """A mode other than the slowest, with the half-widths of its intervals."""

    frequency: float  # [Hz]
    damping_ratio: float
    frequency_error: float
    damping_ratio_error: float


def correlation_matrix(covariance: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """Return the correlation matrix of a covariance; rows and columns with zero variance are zero."""
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    inverse = np.divide(1.0, spread, out=np.zeros_like(spread), where=spread > 0.0)
    return np.asarray(covariance * np.outer(inverse, inverse))


def model_with_changed_value(model: M, name: str, value: float) -> M:
    """Return the model with another value of a parameter or an initial value."""
    changes: dict[str, Any] = {"hidden": {**model.hidden, name: value}}
    if name in ("height", "velocity"):
        height, velocity = model.initial
        changes = {"initial": (value, velocity) if name == "height" else (height, value)}
    else:
        for part in ("parameters", "conventions"):
            if name in (known := getattr(model, part)):
                changes = {part: {**known, name: value}}
    return dataclasses.replace(model, **changes)


def predict_heights_and_deviations(
    model: M,
    times: Float[np.ndarray, "n"],
    inputs: Mapping[str, Float[np.ndarray, "n"]] | None,  # at the times
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Return heights [m] at times [s] from the fitted initial state, and their standard deviations."""
    # The variances of the principal directions of the correlation matrix add.
    covariance, names = model.covariance, model.covariance_names
    if not names:
        raise InputError("the model has no covariance; fit it to a record")
    here = model.simulate(times, inputs=inputs).height
    size = max(float(np.ptp(here)), 1e-300)
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    strengths, directions = np.linalg.eigh(correlation_matrix(covariance))
    values = np.array([parameter_value(model, name) for name in names])

    def motion(step: np.ndarray) -> np.ndarray:
        """Return the heights after a change of the fitted numbers; NaN without a solution."""
        other = model
        for name, value, change in zip(names, values, step, strict=True):
            if change != 0.0:
                other = model_with_changed_value(other, name, float(value + change))
        try:
            return other.simulate(times, inputs=inputs).height
        except InputError:
            return np.full(len(here), np.nan)

    variance = np.zeros(len(here))
    with np.errstate(all="ignore"):
        for strength, direction in zip(strengths, directions.T, strict=True):
            sigma = spread * direction * math.sqrt(max(float(strength), 0.0))
            variance += _motion_change_along_direction(motion, here, sigma, size) ** 2
    return here, np.sqrt(variance)


def _motion_change_along_direction(
    motion: Callable[[np.ndarray], np.ndarray], here: np.ndarray, sigma: np.ndarray, size: float
) -> np.ndarray:
    """Return the change of the motion, to first order, for a change ``sigma`` of the fitted numbers."""
    # Along an undetermined direction one standard deviation is large and the motion is linear only over a
    # small part of it, so the step is shortened. A change below the solver's error counts as zero.
    fraction = _STEP
    for _ in range(_ROUNDS if sigma.any() else 0):
        above, below = motion(fraction * sigma), motion(-fraction * sigma)
        odd = 0.5 * (above - below)
        even = float(np.abs(0.5 * (above + below) - here).max())
        most = float(np.abs(odd).max())
        if even <= max(_STRAIGHT * most, _ERROR * size):
            return odd / fraction if most > _ERROR * size else np.zeros_like(here)
        fraction *= 0.1
    return np.zeros_like(here)


def parameter_value(model: FittedLaw, name: str) -> float:
    """Return a parameter or an initial value by its name."""
    known = {**model.all_parameters, "height": model.initial[0], "velocity": model.initial[1]}
    return float(known[name] if name in known else model.hidden.get(name, 0.0))


def interval_half_widths(
    model: M, figures: Callable[[M], Float[np.ndarray, "k"] | None], here: Float[np.ndarray, "k"]
) -> Float[np.ndarray, "k"] | None:
    """Return interval half-widths of derived quantities by linear error propagation; None on failure."""
    deviations = np.sqrt(np.maximum(np.diag(model.covariance), 0.0))
    slopes = np.zeros((len(here), len(deviations)))
    for k, (name, deviation) in enumerate(zip(model.covariance_names, deviations, strict=True)):
        value = parameter_value(model, name)
        if deviation <= _HELD * abs(value):
            continue
        step = max(_FIGURE_STEP * deviation, _MINIMUM_STEP * abs(value))
        above, below = (
            figures(model_with_changed_value(model, name, value + side * step)) for side in (1.0, -1.0)
        )
        if above is None or below is None:
            return None
        slopes[:, k] = (above - below) / (2.0 * step)
    variance = np.einsum("ij,jk,ik->i", slopes, model.covariance, slopes)
    return np.asarray(model.quantile * np.sqrt(np.maximum(variance, 0.0)))


def faster_modes(model: FittedLaw) -> tuple[FasterMode, ...]:
    """Return all modes but the slowest of a law with several coordinates."""
    rest = model.at_rest
    if rest is None or not model.law.other_coordinates:
        return ()

    def faster_frequencies_and_damping_ratios(model: FittedLaw) -> np.ndarray | None:
        swing = small_oscillation(model.law, list(model.all_parameters.values()), rest.height)
        if isinstance(swing, NoOscillationReason):
            return None
        return np.array([figure for period, ratio in swing.faster for figure in (1.0 / period, ratio)])

    here = faster_frequencies_and_damping_ratios(model)
    errors = (
        None if here is None else interval_half_widths(model, faster_frequencies_and_damping_ratios, here)
    )
    if here is None or errors is None:
        return ()
    pairs = zip(here.reshape(-1, 2), errors.reshape(-1, 2), strict=True)
    return tuple(FasterMode(*map(float, (*mode, *error))) for mode, error in pairs)


def plot_model(
    model: FittedLaw,
    time: Float[np.ndarray, "n"],
    height: Float[np.ndarray, "n"],
    recorded: Float[np.ndarray, "n"] | None,
    ax: Axes,
) -> Axes:
    """Draw a model's heights [m or rad] against time [s], on top of recorded heights if given."""
    from granular.shared.plotting import COLOURS, GREY, figure_label

    unit, factor = DRAWN_UNITS[model.coordinate_unit]
    if recorded is not None:
        ax.plot(time, factor * recorded, ".", markersize=2.0, color=GREY, label="record")
    label = figure_label(model.law.name)
    ax.plot(time, factor * height, color=COLOURS[0], label=label)
    ax.set(xlabel="time [s]", ylabel=f"{model.coordinate} [{unit}]")
    ax.legend(loc="upper right", frameon=False)
    return ax


def plot_decay(model: FittedLaw, ax: Axes) -> Axes:
    """Draw the free decay of a model from the fitted height farthest from equilibrium."""
    level = 0.0 if model.at_rest is None else model.at_rest.height
    ends = [end - level for end in model.domain.get("height", model.initial[:1])]
    decay = free_decay(model, max(ends, key=abs))
    return plot_model(model, decay.time, decay.height, None, ax)


def plot_residuals(
    model: FittedLaw, time: Float[np.ndarray, "n"], residuals: Float[np.ndarray, "n"], ax: Axes
) -> None:
    """Draw the residuals [m or rad] of a record against time [s]."""
    from granular.shared.plotting import COLOURS

    unit, factor = DRAWN_UNITS[model.coordinate_unit]
    ax.plot(time, factor * residuals, color=COLOURS[1], linewidth=0.6)
    ax.set(xlabel="time [s]", ylabel=f"residual [{unit}]")
