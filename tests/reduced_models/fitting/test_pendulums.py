"""Twenty pendulums by their law as text, with all options as they are."""

from __future__ import annotations

import math
import warnings
from typing import NamedTuple

import numpy as np
import pytest

from granular import PistonRecord
from reduced_models import fit

LAW = "theta'' + 2*lam*theta' + k*sin(theta - rest) = 0"
COUNT = 20


class Pendulum(NamedTuple):
    """A made record, and what it was made with."""

    record: PistonRecord
    k: float
    rest: float
    noise: float


def pendulum(place: int) -> Pendulum:
    """From 10 to 60 degrees, over 5 to 150 periods, with 0.1, 1 or 3 % of noise; by SciPy."""
    from scipy.integrate import solve_ivp

    random = np.random.default_rng(place)
    swing = math.radians(np.linspace(10.0, 60.0, COUNT)[place])
    periods = np.geomspace(5.0, 150.0, COUNT)[7 * place % COUNT]
    k, rest = math.exp(random.uniform(0.0, math.log(100.0))), random.uniform(-3.0, 3.0)
    frequency = math.sqrt(k)
    decay = frequency / (4.0 * math.pi * periods) * random.uniform(0.3, 2.0)
    time = np.linspace(0.0, 2.0 * math.pi * periods / frequency, max(400, round(30 * periods)))
    angle = solve_ivp(
        lambda _, y: [y[1], -2.0 * decay * y[1] - k * math.sin(y[0] - rest)],
        (0.0, time[-1]),
        [rest + swing, 0.0],
        "DOP853",
        rtol=1e-10,
        atol=1e-12,
        t_eval=time,
    ).y[0]
    noise = random.choice([0.001, 0.01, 0.03]) * angle.std()
    height = angle + random.normal(0.0, noise, len(time))
    return Pendulum(PistonRecord(time, height), k, rest, noise)


@pytest.mark.long  # quick: symmetries in `test_words`, a real pendulum in `test_examples`
@pytest.mark.parametrize("place", range(COUNT))
def test_all_records(place: int) -> None:
    made = pendulum(place)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a rare draw of white noise that looks structured
        model = fit(made.record, LAW)
    low, high = model.intervals["k"]
    assert abs(model.parameters["k"] - made.k) < 1.5 * (high - low)
    assert -math.pi < model.parameters["rest"] <= math.pi
    assert model.parameters["rest"] == pytest.approx(made.rest, abs=0.01)
    assert model.quality.residual < 1.1 * made.noise
