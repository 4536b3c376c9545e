"""Two wells that a motion goes over: their equilibria and frequencies, and the motion's own frequency."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from reduced_models.laws.linearization import SmallSwing, law_rates, small_swing
from reduced_models.models.at_rest import engineering_units
from reduced_models.models.model import ReducedModel
from reduced_models.models.prediction import errors_of_figures
from reduced_models.models.quantities import QuantityWithError

LOWER_WELL = "lower well"
_POINTS = 401  # of the range of heights, between which equilibria are looked for
_TRIES = 8  # doublings of the time in which the motion must come back


def well_quantities(model: ReducedModel) -> tuple[QuantityWithError, ...]:
    """Two wells [mm or degrees], their frequencies, and that of a motion over both [Hz]; or nothing."""
    figures = _well_figures(model)
    errors = None if figures is None else errors_of_figures(model, _well_figures, figures)
    if figures is None or errors is None or not len(model.covariance):
        return ()
    units = engineering_units(model.coordinate_unit, None)
    size = f"{units.scale * figures[5]:.3g} {units.length}"
    rows = (
        (LOWER_WELL, "z1", units.length, units.scale),
        ("upper well", "z2", units.length, units.scale),
        ("frequency in the lower well", "f1", "Hz", 1.0),
        ("frequency in the upper well", "f2", "Hz", 1.0),
        (f"frequency over both wells at {size}", "f", "Hz", 1.0),
    )
    return tuple(
        QuantityWithError(name, symbol, unit, scale * float(figures[k]), {"fit": scale * float(errors[k])})
        for k, (name, symbol, unit, scale) in enumerate(rows)
    )


def _well_figures(model: ReducedModel) -> np.ndarray | None:
    """Heights [m] and undamped frequencies [Hz] of two wells, frequency [Hz] and amplitude [m] over both."""
    law = model.law
    if law.hidden or law.inputs or "height" not in model.domain:
        return None
    values = list(model.all_parameters.values())
    rates = law_rates(law, values)

    def force(z: np.ndarray | float) -> np.ndarray:
        return np.asarray(rates(z, 0.0 * np.asarray(z))[0], dtype=float)

    z = np.linspace(*model.domain["height"], _POINTS)
    with np.errstate(all="ignore"):
        pulls = np.broadcast_to(force(z), z.shape)
    stable = np.flatnonzero((pulls[:-1] > 0.0) & (pulls[1:] <= 0.0))
    if not np.isfinite(pulls).all() or len(stable) != 2:
        return None
    swings = [small_swing(law, values, float(z[k])) for k in stable]
    if not all(isinstance(swing, SmallSwing) for swing in swings):
        return None
    wells = sorted((swing.z, 1.0 / swing.period) for swing in swings)  # type: ignore[union-attr]  # checked
    orbit = _orbit_without_damping(force, model)
    if orbit is None:
        return None
    low, high, frequency = orbit
    (first, slow), (second, fast) = wells
    if not low < first < second < high:
        return None
    return np.array([first, second, slow, fast, frequency, 0.5 * (high - low)])


def _orbit_without_damping(
    force: Callable[[Any], np.ndarray], model: ReducedModel
) -> tuple[float, float, float] | None:
    """Lowest and highest height [m] and frequency [Hz] of the motion from the record's start, undamped."""
    from scipy.integrate import solve_ivp

    height, velocity = model.initial
    size = float(np.ptp(model.domain["height"]))
    pulls = np.abs(force(np.array(model.domain["height"])))
    duration = 4.0 * math.tau * math.sqrt(size / float(pulls.max()))
    for _ in range(_TRIES):
        motion = solve_ivp(
            lambda _, state: (state[1], float(force(state[0]))),
            (0.0, duration),
            (height, velocity),
            "DOP853",
            events=lambda _, state: state[1],
            rtol=1e-10,
            atol=1e-12 * size,
        )
        # A release at velocity zero is a turn too, or none, by rounding.
        turns = [k for k, time in enumerate(motion.t_events[0]) if time > 1e-6 * duration][:3]
        if len(turns) == 3:
            ends = motion.y_events[0][turns[:2], 0]
            period = float(motion.t_events[0][turns[2]] - motion.t_events[0][turns[0]])
            return float(ends.min()), float(ends.max()), 1.0 / period
        duration *= 2.0
    return None
