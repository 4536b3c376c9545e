"""Made signals of sensors: a law's free motion, solved together with the sensor's own filter."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from granular import PistonRecord
from reduced_models import Sensor, law_named
from reduced_models.laws.equation import compile_rates

SAMPLES, PERIODS = 2000, 20.0


class Made(NamedTuple):
    """A made record.

    Attributes
    ----------
    record : PistonRecord
    sensor : Sensor
    law : str
    truth : mapping of str to float
        Values of the law's parameters.
    """

    record: PistonRecord
    sensor: Sensor
    law: str
    truth: Mapping[str, float]


def made_signal(
    law_name: str,
    truth: Mapping[str, float],
    start: float,
    sensor: Sensor,
    gain: float,
    offset: float,
    noise: float,
    random: np.random.Generator,
) -> Made:
    """Free motion released at a height, as a sensor shows it; ``noise`` is of the rms signal."""
    law = law_named(law_name)
    field = compile_rates(law.equation, law.inputs, "numpy")
    values = [truth[name] for name in law.parameters]
    size = 2 + len(law.hidden)
    corner = 2.0 * math.pi * (sensor.corner_frequency or 0.0)
    ratio = 2.0 * (sensor.damping_ratio or 0.0)

    def rates(_: float, state: np.ndarray) -> list[Any]:
        motion = field(*state[:size], *values)
        slopes = [state[1], *motion]
        if sensor.filter_order:
            seen = (state[0], state[1], motion[0])[sensor.derivative_order]
            if sensor.filter_order == 1:
                slopes.append(corner * (seen - state[size]))
            else:
                p, q = state[size:]
                slopes += [corner * q, corner * (seen - p - ratio * q)]
        return slopes

    omega = truth["omega"] if "omega" in truth else math.sqrt(truth["k"])
    time = np.linspace(0.0, PERIODS * 2.0 * math.pi / omega, SAMPLES)
    first = np.zeros(size + sensor.filter_order)
    first[0] = start
    states = solve_ivp(rates, (0.0, time[-1]), first, t_eval=time, rtol=1e-9, atol=1e-13, method="LSODA").y
    seen = (
        states[sensor.derivative_order] if sensor.derivative_order < 2 else field(*states[:size], *values)[0]
    )
    if sensor.filter_order:
        low = states[size]
        high = seen - low - (ratio * states[size + 1] if sensor.filter_order == 2 else 0.0)
        seen = low if sensor.low_pass is not None else high
    signal = gain * seen
    signal = signal + offset + noise * signal.std() * random.normal(size=SAMPLES)
    columns = {"time": time, "acceleration" if sensor.derivative_order == 2 else "velocity": signal}
    return Made(PistonRecord.from_columns(columns), sensor, law_name, truth)


def random_signal(kind: str, seed: int) -> Made:
    """Record of a kind, ``acceleration``, ``velocity`` or ``geophone``, by a seed."""
    random = np.random.default_rng([seed, len(kind)])
    omega = 2.0 * math.pi * random.uniform(3.0, 12.0)
    start = 1e-3 * random.uniform(1.0, 5.0)
    lam = omega * math.exp(random.uniform(math.log(0.005), math.log(0.05)))
    laws: dict[str, Mapping[str, float]] = {
        "linear": {"lam": lam, "omega": omega, "g0": 0.0},
        "quadratic-drag": {"omega": omega, "g0": 0.0, "c": 0.05 / start},
        "coulomb": {"friction": 0.04 * omega**2 * start, "omega": omega, "g0": 0.0},
    }
    law = list(laws)[seed % 3]
    noise = random.uniform(0.005, 0.03)
    if kind == "acceleration":
        sensor = Sensor("acceleration", low_pass=200.0, damping_ratio=0.7)
        gain, offset = 1.0, 0.2 * omega**2 * start * random.normal()
    elif kind == "velocity":
        sensor, gain, offset = Sensor("velocity"), 1.0, 0.1 * omega * start * random.normal()
    else:
        sensor = Sensor("velocity", gain="free", high_pass=4.5, damping_ratio=0.6)
        gain, offset = 28.8, 0.01 * random.normal()
    return made_signal(law, laws[law], start, sensor, gain, offset, noise, random)
