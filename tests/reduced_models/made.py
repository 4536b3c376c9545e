"""Synthetic motions, records, sensor signals and strokes for tests, and checks of the fitted values."""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from granular import PistonRecord
from reduced_models import Sensor, law_named
from reduced_models.laws import FORCE_LAWS
from reduced_models.laws.equation import compile_observation, compile_rates


def moved(
    acceleration: Callable[[float, float, float], Any],
    time: np.ndarray,
    start: float = 1.0,
    velocity: float = 0.0,
    method: str = "DOP853",
    **options: float,
) -> np.ndarray:
    """Return heights (n,) of z'' = acceleration(t, z, z')."""
    options = {"rtol": 1e-10, "atol": 1e-12, **options}
    total_duration = (time[0], time[-1])
    solved = solve_ivp(
        lambda t, y: [y[1], acceleration(t, *y)], total_duration, [start, velocity], method, time, **options
    )
    return np.asarray(solved.y[0])


def damped_cosine(
    time: np.ndarray, size: float = 1e-3, decay: float = 0.8, frequency: float = 21.8
) -> np.ndarray:
    """Return a damped cosine (n,) with the damped angular frequency [rad/s]."""
    return np.asarray(size * np.exp(-decay * time) * np.cos(frequency * time))


def noise(count: int, level: float, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, level, count)


def noisy(time: np.ndarray, height: np.ndarray, level: float, seed: int = 0, **extra: Any) -> PistonRecord:
    """Return a record with white noise of a given standard deviation [m]."""
    return PistonRecord(time, height + noise(len(time), level, seed), **extra)


def assert_found(model: Any, truth: Mapping[str, float], widths: float = 1.5) -> None:
    """Assert that parameters differ from the true values by at most a few widths of their intervals."""
    for name, value in truth.items():
        low, high = model.intervals[name]
        assert abs(model.parameters[name] - value) <= widths * (high - low), name


def half_width(model: Any, name: str) -> float:
    low, high = model.intervals[name]
    return 0.5 * (high - low)


SAMPLES, PERIODS = 2000, 20.0


class Made(NamedTuple):
    """A synthetic record, its sensor and law, and the true values of the law's parameters."""

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
    """Return a free motion released at a height, as a sensor shows it; ``noise`` is relative to the rms
    signal.
    """
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


STROKE_SAMPLES, CYCLES = 1500, 8.0
NOISY_STROKE = 2e-4  # of the amplitude


def made_stroke(
    law_name: str,
    truth: Mapping[str, float],
    amplitude: float,
    frequency: float,
    noise: float,
    random: np.random.Generator,
    middle: float = 0.0,
) -> PistonRecord:
    """Return the force along a stroke whose amplitude grows from a third to its full value.

    ``noise`` is relative to the rms force.
    """
    law = FORCE_LAWS[law_name]
    field = compile_rates(law.equation, law.inputs, "numpy")
    observe = compile_observation(law.equation, law.inputs, "force", "numpy")
    values = [truth[name] for name in law.parameters]
    end, omega = CYCLES / frequency, 2.0 * math.pi * frequency

    def stroke(time: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        size, growth = amplitude * (1.0 + 2.0 * time / end) / 3.0, amplitude * 2.0 / (3.0 * end)
        wave, turn = np.sin(omega * time), omega * np.cos(omega * time)
        return middle + size * wave, size * turn + growth * wave

    time = np.linspace(0.0, end, STROKE_SAMPLES)
    hidden = np.zeros((len(law.hidden), STROKE_SAMPLES))
    if law.hidden:
        hidden = solve_ivp(
            lambda at, state: field(*state, *stroke(at), *values),
            (0.0, end),
            hidden[:, 0],
            t_eval=time,
            rtol=1e-8,
            atol=1e-10,
            max_step=0.02 / frequency,
        ).y
    height, velocity = stroke(time)
    force = np.asarray(observe(*hidden, height, velocity, *values))
    force = force + noise * force.std() * random.normal(size=STROKE_SAMPLES)
    height = height + NOISY_STROKE * amplitude * random.normal(size=STROKE_SAMPLES)
    return PistonRecord(time, height, force=force)


def random_stroke(law: str, seed: int) -> tuple[PistonRecord, dict[str, float]]:
    """Return the record for a seed, with the true values."""
    random = np.random.default_rng([seed, len(law)])
    size, frequency = 1e-3 * random.uniform(4.0, 15.0), random.uniform(0.5, 4.0)
    speed = 2.0 * math.pi * frequency * size
    force = random.uniform(5.0, 50.0)  # of each part [N]
    parts = random.uniform(0.3, 1.0, 3)
    truth = {"c": force * parts[0] / speed, "k": force * parts[1] / size, "zero": force * random.normal()}
    friction = {"friction": force * parts[2]}
    noise = random.uniform(0.003, 0.02)
    if law == "viscous-coulomb":
        truth |= friction | {"creep": speed * math.exp(random.uniform(-4.0, -2.0))}
    elif law == "bouc-wen":
        truth |= friction | {"rho": random.uniform(3.0, 20.0) / size, "sigma": random.uniform(0.6, 1.5)}
    else:
        middle = size * random.uniform(4.0, 8.0)
        truth = {"c": truth["c"], "zero": 0.0, "load": 3.0 * force, "rest": middle}
        truth |= {"power": random.uniform(2.0, 3.0), "modulus": random.uniform(0.3, 1.0)}
        truth |= {"strength": random.uniform(0.02, 0.06)}
        return made_stroke(law, truth, size, frequency, noise, random, middle), truth
    return made_stroke(law, truth, size, frequency, noise, random), truth
