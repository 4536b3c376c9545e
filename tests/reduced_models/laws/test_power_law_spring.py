"""The power-law spring is the law of a column of grains that follow the piston affinely."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.equation import compile_rates

LAYERS = 20
MASS, WEIGHT, REST, POWER = 7.5, 9.8, 0.06, 2.5


def column(resistance: float, times: np.ndarray, start: float) -> np.ndarray:
    """Height of a piston on layers of grains without mass, each with its fraction of the drag."""
    fraction = resistance / LAYERS

    def rates(_: float, state: np.ndarray) -> np.ndarray:
        places, speed = state[:-1], state[-1]
        strain = np.diff(places, prepend=0.0) * LAYERS / REST
        force = MASS * WEIGHT * strain**-POWER
        moved = (force[:-1] - force[1:]) / fraction
        # Half a layer goes with the piston.
        acceleration = (force[-1] - 0.5 * fraction * speed) / MASS - WEIGHT
        return np.concatenate([moved, [speed, acceleration]])

    places = start * np.arange(1, LAYERS + 1) / LAYERS
    total_duration = (times[0], times[-1])
    first = np.append(places, 0.0)
    found = solve_ivp(rates, total_duration, first, "BDF", times, rtol=1e-5, atol=1e-7)
    return np.asarray(found.y[LAYERS - 1])


def test_an_affine_column_falls_as_the_law_says() -> None:
    """From twice the height of rest; the drag is a third of that of all grains."""
    resistance, times, start = 10.0, np.linspace(0.0, 1.0, 500), 2.0 * REST
    known = {"lam": resistance / (6.0 * MASS), "weight": WEIGHT, "rest": REST, "power": POWER}
    law = LAWS["power-law-spring"]
    field = compile_rates(law.equation, (), "math")

    def rates(_: float, state: np.ndarray) -> list[float]:
        z, v = map(float, state)
        return [v, field(z, v, *(known[name] for name in law.parameters))[0]]

    said = solve_ivp(rates, (0.0, 1.0), [start, 0.0], "LSODA", times, rtol=1e-8, atol=1e-10).y[0]
    error = said - column(resistance, times, start)
    assert np.sqrt(np.mean(error**2)) < 0.001 * (start - REST)
