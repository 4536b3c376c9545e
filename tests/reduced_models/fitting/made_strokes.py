"""Made forces on prescribed strokes: laws solved along a swept stroke, and noise by a seed."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from scipy.integrate import solve_ivp

from granular import PistonRecord
from reduced_models.laws import FORCE_LAWS
from reduced_models.laws.equation import compile_observation, compile_rates

SAMPLES, CYCLES = 1500, 8.0
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
    """Force on a stroke whose amplitude grows from a third; ``noise`` is of the rms force."""
    law = FORCE_LAWS[law_name]
    field = compile_rates(law.equation, law.inputs, "numpy")
    observe = compile_observation(law.equation, law.inputs, "force", "numpy")
    values = [truth[name] for name in law.parameters]
    end, omega = CYCLES / frequency, 2.0 * math.pi * frequency

    def stroke(time: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        size, growth = amplitude * (1.0 + 2.0 * time / end) / 3.0, amplitude * 2.0 / (3.0 * end)
        wave, turn = np.sin(omega * time), omega * np.cos(omega * time)
        return middle + size * wave, size * turn + growth * wave

    time = np.linspace(0.0, end, SAMPLES)
    hidden = np.zeros((len(law.hidden), SAMPLES))
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
    force = force + noise * force.std() * random.normal(size=SAMPLES)
    height = height + NOISY_STROKE * amplitude * random.normal(size=SAMPLES)
    return PistonRecord(time, height, force=force)


def random_stroke(law: str, seed: int) -> tuple[PistonRecord, dict[str, float]]:
    """Record by a seed, with the numbers behind it."""
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
