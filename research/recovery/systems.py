"""Thirteen oscillators with known parameters, and synthetic records of them.

The motions are solved by SciPy, independently of the tested code.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from reduced_models.laws.equation import compile_rates
from reduced_models.laws.law import Law

NOISES = (0.001, 0.01, 0.03, 0.1)
"""Standard deviations of the noise, over the standard deviation of the motion."""
SEEDS = 5
REACHED = 1.05
"""A residual up to this many times the added noise counts as the true optimum."""
LOST = 1.5
"""Above this many times the noise a search must not report that all starts agree."""


class RecoverySystem(NamedTuple):
    """An oscillator.

    Attributes
    ----------
    name : str
    law : str
        A law of the package by its name, or an equation.
    true : mapping of str to float
        True parameters of the law.
    start : tuple of float
        Initial height, velocity and hidden states.
    duration, samples : float, int
        Duration [s] and number of samples of a record.
    driven : bool
        True if the record has a force.
    """

    name: str
    law: str
    true: Mapping[str, float]
    start: tuple[float, ...]
    duration: float
    samples: int
    driven: bool = False


_DUFFING = "z'' + 2*lam*z' + omega**2*z + beta*z**3 = 0"

SYSTEMS = (
    RecoverySystem("linear", "linear", {"lam": 0.05, "omega": 1.05, "g0": -1.0}, (1.0, 0.0), 60.0, 1000),
    RecoverySystem(
        "van der Pol",
        "van-der-pol",
        {"mu": 0.5, "rest": 0.3, "width": 1.0, "omega": 1.05},
        (0.5, 0.0),
        60.0,
        1000,
    ),
    # The frequency falls by 30 % in 150 periods.
    RecoverySystem(
        "hardening Duffing",
        "duffing",
        {"lam": 0.0025, "k": 1.0, "rest": 0.4, "beta": 1.0},
        (1.4, 0.0),
        880.0,
        4000,
    ),
    # It rises by 30 %.
    RecoverySystem(
        "softening Duffing",
        "duffing",
        {"lam": 0.0025, "k": 1.0, "rest": -0.2, "beta": -0.6},
        (0.75, 0.0),
        960.0,
        4000,
    ),
    RecoverySystem(
        "pendulum",
        "z'' + 2*lam*z' + k*sin(z - rest) = 0",
        {"lam": 0.003, "k": 9.0, "rest": 0.2},
        (2.3, 0.0),
        210.0,
        4000,
    ),
    RecoverySystem(
        "Bouc-Wen",
        "bouc-wen",
        {"omega": 1.05, "friction": 0.5, "rho": 1.0, "sigma": 0.8, "g0": -1.0},
        (3.0, 0.0, 0.0),
        60.0,
        1000,
    ),
    RecoverySystem(
        "Coulomb", "coulomb", {"friction": 0.03, "omega": 1.05, "g0": -1.0}, (1.5, 0.0), 60.0, 1000
    ),
    RecoverySystem(
        "quadratic drag", "quadratic-drag", {"c": 0.1, "omega": 1.05, "g0": -1.0}, (1.5, 0.0), 60.0, 1000
    ),
    RecoverySystem(
        "quintic",
        "z'' + c*z' + k*(z - rest) + q*(z - rest)**5 = 0",
        {"c": 0.02, "k": 1.0, "rest": 0.3, "q": 0.5},
        (1.6, 0.0),
        200.0,
        2000,
    ),
    RecoverySystem(
        "parametric",
        "z'' + c*z' + k*(1 + h*cos(w*t))*z = 0",
        {"c": 0.05, "k": 1.1, "h": 0.3, "w": 1.3},
        (1.0, 0.0),
        80.0,
        1500,
    ),
    RecoverySystem(
        "two wells", "z'' + c*z' - a*z + b*z**3 = 0", {"c": 0.04, "a": 1.0, "b": 1.0}, (1.8, 0.0), 80.0, 1500
    ),
    RecoverySystem(
        "driven Duffing",
        "z'' + c*z' + k*z + b*z**3 = g*force",
        {"c": 0.2, "k": 1.0, "b": 0.5, "g": 1.0},
        (0.0, 0.0),
        200.0,
        2500,
        driven=True,
    ),
    RecoverySystem(
        "stick-slip",
        "z'' + c*z' + k*z = f*tanh(10*(belt - z'))*(1 + d*exp(-3*abs(belt - z')))",
        {"c": 0.05, "k": 1.0, "f": 0.4, "belt": 0.5, "d": 0.6},
        (1.2, 0.0),
        60.0,
        1500,
    ),
)


def law_of_system(system: RecoverySystem) -> Law:
    """Return the law of a system."""
    from reduced_models.fitting.fit import resolve_law

    return resolve_law(system.law, _record_with_force(system, np.linspace(0.0, 1.0, 2), np.zeros(2)))


@functools.cache
def noiseless_motion(system: int) -> PistonRecord:
    """Return the motion of the system with an index in `SYSTEMS`, by SciPy at a tolerance of 1e-10."""
    from scipy.integrate import solve_ivp

    item = SYSTEMS[system]
    time = np.linspace(0.0, item.duration, item.samples)
    law = law_of_system(item)
    field = compile_rates(law.equation, law.inputs, "numpy")
    values = [item.true[name] for name in law.parameters]

    def rates(t: float, state: np.ndarray) -> list[float]:
        inputs = [t if name == "t" else float(multisine_force(t)) for name in law.inputs]
        return [state[1], *field(*state, *inputs, *values)]

    result = solve_ivp(rates, (0.0, item.duration), item.start, "LSODA", rtol=1e-10, atol=1e-11, t_eval=time)
    return _record_with_force(item, time, result.y[0])


def make_noisy_record(system: int, noise: float, seed: int) -> PistonRecord:
    """Make a record of the system with that index, with white noise."""
    clean = noiseless_motion(system)
    random = np.random.default_rng([system, seed, round(1e6 * noise)])
    return PistonRecord(
        clean.time,
        clean.height + random.normal(0.0, noise * clean.height.std(), len(clean)),
        force=clean.force,
    )


def multisine_force(t: np.ndarray | float) -> np.ndarray:
    """Return a force of ten sines up to twice the natural frequency of small oscillations."""
    random = np.random.default_rng(0)
    phases = random.uniform(0.0, 2.0 * math.pi, 10)
    pitches = np.linspace(0.15, 2.1, 10)
    return np.asarray(0.4 * np.sin(np.multiply.outer(t, pitches) + phases).sum(axis=-1))


def _record_with_force(system: RecoverySystem, time: np.ndarray, height: np.ndarray) -> PistonRecord:
    return PistonRecord(time, height, force=multisine_force(time) if system.driven else None)
