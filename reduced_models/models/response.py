"""Decays, cycles and driven responses of a model.

Forces are per kilogram of what moves: multiply by the piston's mass for newtons and joules. Cycles
are harmonic ones; see `reduced_models.laws.linearization`.
"""

from __future__ import annotations

import dataclasses
import math
import re
from typing import Any, NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.array_types import Float
from granular.shared.errors import InputError, quote
from reduced_models.laws.law import Law
from reduced_models.laws.linearization import (
    Rates,
    centre_cycles,
    harmonic_coefficients,
    harmonic_cycles,
    law_rates,
)
from reduced_models.models.at_rest import HarmonicCycle
from reduced_models.models.fitted_law import FittedLaw

# Over five decades: neighbours are 5 % apart, and roots between them are interpolated in logarithms.
_AMPLITUDES = 240
_PER_PERIOD = 64
_OBSERVATION_OR_RATE = re.compile(r"\s*[^\W\d]\w*'?\s*=")


class SteadyAmplitudes(NamedTuple):
    """Steady amplitudes under a harmonic force, by describing functions."""

    frequency: Float[np.ndarray, "n"]  # angular [rad/s]
    low: Float[np.ndarray, "n"]  # [m]
    high: Float[np.ndarray, "n"]  # [m]


def free_decay(model: FittedLaw, amplitude: float, periods: float = 10.0) -> PistonRecord:
    """Motion of a piston released from an amplitude [m] above its level of rest."""
    if not 0.0 < periods < math.inf:
        raise InputError(f"periods = {quote(periods)}; give a number above 0")
    height, period = _rest_height_and_period(model)
    time = np.linspace(0.0, periods * period, max(2, math.ceil(periods * _PER_PERIOD) + 1))
    still = {name: np.zeros_like(time) for name in model.law.inputs}
    return model.simulate(time, height + amplitude, 0.0, still)


def harmonic_cycle(model: FittedLaw, amplitude: float, frequency: float | None = None) -> HarmonicCycle:
    """Harmonic cycle of a model, its inputs at zero; amplitude [m], frequency [rad/s]."""
    if not amplitude > 0.0:
        raise InputError(f"amplitude = {quote(amplitude)} m; give one above 0")
    _refuse_further_coordinates(model)
    if frequency is not None and not 0.0 < frequency < math.inf:
        raise InputError(f"frequency = {quote(frequency)} rad/s; give one above 0")
    height, period = _rest_height_and_period(model)
    result = harmonic_cycles(
        _model_rates(model),
        len(model.law.hidden),
        amplitude,
        height,
        2.0 * math.pi / period if frequency is None else frequency,
        free=frequency is None,
    )
    omega, stiffness, damping = (float(value[0]) for value in result[1:])
    if not math.isfinite(stiffness):
        raise InputError(
            f"a cycle of amplitude {amplitude:g} m leaves where the law "
            f"{quote(model.law.name)} is defined; give a smaller one"
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
    """Steady amplitudes [m] by describing functions; force [m/s^2], frequencies [rad/s], largest [m]."""
    if not 0.0 < force < math.inf:
        raise InputError(f"force = {quote(force)} N/kg; give one above 0")
    _refuse_further_coordinates(model)
    if largest is not None and not 0.0 < largest < math.inf:
        raise InputError(f"largest = {quote(largest)} m; give one above 0")
    height, period = _rest_height_and_period(model)
    omega = np.asarray(frequencies, dtype=np.float64)
    if omega.ndim != 1 or not ((omega > 0.0) & (omega < math.inf)).all():
        raise InputError("frequencies must be an array (n,) of angular frequencies above 0")
    edges = model.domain.get("height", (height, height))
    far = largest or 10.0 * max(abs(edge - height) for edge in edges)
    amplitude = far * np.logspace(-5.0, 0.0, _AMPLITUDES)
    rates, hidden = _model_rates(model), len(model.law.hidden)
    centre = np.full_like(amplitude, height)
    for _ in range(4):
        centre, *_ = centre_cycles(
            rates, hidden, amplitude, centre, np.full_like(amplitude, 2 * math.pi / period)
        )
    _, stiffness, damping = harmonic_coefficients(
        rates, hidden, amplitude[:, None], centre[:, None], omega[None, :]
    )
    # A steady cycle: the force carries stiffness less inertia, and damping a quarter period later.
    needed = amplitude[:, None] * np.hypot(stiffness - omega**2, damping * omega)
    low, high = np.full((2, len(omega)), np.nan)
    for k in range(len(omega)):
        roots = _zero_crossings(np.log(amplitude), np.log(needed[:, k] / force))
        if len(roots):
            low[k], high[k] = math.exp(roots[0]), math.exp(roots[-1])
    return SteadyAmplitudes(omega, low, high)


def law_with_force_input(law: Law, name: str = "drive") -> Law:
    """Drive a law by a force per kilogram, an input in the units of z''.

    Parameters
    ----------
    law : Law
        Law without that input, its coordinate written ``z``.
    name : str
        Name of the input, a column of the records that the law is fitted to; ``"t"`` would be the time.

    Returns
    -------
    Law
        Law with z'' less the input in place of z'' in its first equation of motion with z''; parameters
        and their units stay. It has no start values of its own.

    Raises
    ------
    InputError
        If the law has something else of that name, no ``z''`` or a prescribed stroke, or the name
        cannot stand for an input, as ``"z"``, ``"pi"`` and ``"1x"`` cannot.

    Examples
    --------
    >>> from reduced_models import law_with_force_input, law_named
    >>> law_with_force_input(law_named("linear"), "force").equation
    "(z'' - force) + 2*lam*z' + omega**2*z = g0"
    """
    if name in (*law.parameters, *law.hidden, *law.inputs):
        raise InputError(f"the law {quote(law.name)} has a {quote(name)} already; give another name")
    if law.prescribed:
        raise InputError(f"a record prescribes the stroke of the law {quote(law.name)}; no force drives it")
    line = law.parsed_equation.line
    push = name if line is None else f"{name}/({line[1]})"  # in the coordinate of the text
    statements = law.equation.split(";")
    for k, statement in enumerate(statements):
        # What is observed is of the whole acceleration.
        if "z''" in statement and not _OBSERVATION_OR_RATE.match(statement):
            statements[k] = statement.replace("z''", f"(z'' - {push})")
            break
    text = ";".join(statements)
    changes: dict[str, Any] = {"start": None, "inputs": (*law.inputs, name)}
    driven = dataclasses.replace(law, name=f"{law.name}, driven", equation=text, **changes)
    _ = driven.parsed_equation  # which refuses a name that is none
    return driven


def _refuse_further_coordinates(model: FittedLaw) -> None:
    if model.law.other_coordinates:
        raise InputError(
            f"the law {quote(model.law.name)} has several coordinates, and a harmonic cycle is of one; take "
            "its modes, .at_rest and .faster_modes, or .simulate"
        )


def _rest_height_and_period(model: FittedLaw) -> tuple[float, float]:
    """Height [m] and small period [s] at rest."""
    if model.at_rest is None:
        raise InputError(
            f"the law {quote(model.law.name)} has no level of rest near its record, which this needs"
        )
    return model.at_rest.height, model.at_rest.period


def _model_rates(model: FittedLaw) -> Rates:
    return law_rates(model.law, list(model.all_parameters.values()))


def _zero_crossings(position: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Arguments at which a function passes zero."""
    good = np.isfinite(value)
    position, value = position[good], value[good]
    at = np.flatnonzero(np.sign(value[1:]) != np.sign(value[:-1]))
    fraction = value[at] / (value[at] - value[at + 1])
    return np.asarray(position[at] + fraction * (position[at + 1] - position[at]))
