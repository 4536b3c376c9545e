"""The law for beds that rub: its loops in closed form, its start values, and records of simulated beds."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import Equilibrium, PistonRecord, equilibrium, load_scene, simulate
from granular.linear import MotionFriction
from reduced_models import FitOptions, fit, roll_out
from reduced_models.identification.candidate_laws import frequency_rises
from reduced_models.laws import FORCE_LAWS
from reduced_models.laws.equation import compile_observation, compile_rates
from reduced_models.laws.rubbing_bed import ELEMENTS, rubbing_bed_near
from reduced_models.records.first_guesses import first_guesses
from tests.reduced_models.fitting.made_strokes import made_stroke

D, NOISE = 6e-3, 2e-6
CASES = ((0.02, 0.2), (0.1, 1.0), (0.6, 1.0))
"""Static coefficients of friction, and lifts of the record that is fitted [D]."""
LOOP = {"c": 0.0, "k": 500.0, "friction": 3.0, "zero": 0.0, "travel": 2e-3, "spread": 1.5}


def test_a_loop_loses_what_its_elements_do() -> None:
    """Each takes four times its force over the amplitude that is beyond its travel."""
    law, size = FORCE_LAWS["rubbing-bed"], 8e-3
    field = compile_rates(law.equation, law.inputs, "numpy")
    observe = compile_observation(law.equation, law.inputs, "force", "numpy")
    values = [LOOP[name] for name in law.parameters]

    def rates(time: float, state: np.ndarray) -> list[float]:
        z, speed = size * math.sin(time), size * math.cos(time)
        arguments = (*state[1:], z, speed, *values)
        return [float(observe(*arguments)) * speed, *(float(rate) for rate in field(*arguments))]

    cycle = 2.0 * math.pi
    path = solve_ivp(
        rates, (0.0, 2.0 * cycle), np.zeros(ELEMENTS + 1), t_eval=[cycle, 2.0 * cycle], max_step=0.01
    )
    ends = path.y[0]
    travels = 2e-3 * ((np.arange(ELEMENTS) + 0.5) / ELEMENTS) ** 1.5
    assert ends[1] - ends[0] == pytest.approx(4.0 * 3.0 * (size - travels.mean()), rel=0.02)


def test_starts_of_a_known_bed_are_near_its_figures() -> None:
    time = np.linspace(0.0, 2.0, 1000)
    guess = first_guesses(time, 0.06 + 1e-3 * np.exp(-time) * np.cos(22.0 * time))
    known = MotionFriction(40.0, 20.0, 0.3, 3600.0, -2e5, 0.04, 3.5)
    law = rubbing_bed_near(known)
    assert law.start is not None
    drawn = law.start(guess, np.random.default_rng(0), 100)
    assert set(drawn) == set(law.parameters)
    assert np.median(drawn["travel"]) == pytest.approx(0.3 / 3600.0, rel=0.05)
    assert np.median(drawn["omega"]) == pytest.approx(7.0 * math.pi, rel=0.05)
    assert np.median(drawn["bend"]) == pytest.approx(-2e5 / 7200.0, rel=0.05)


@pytest.mark.long
def test_a_made_loop_gives_its_numbers_back() -> None:
    record = made_stroke("rubbing-bed", LOOP | {"c": 5.0}, 8e-3, 1.0, 0.01, np.random.default_rng(0))
    model: Any = fit(record, "rubbing-bed", options=FitOptions(measured="force"))
    for name, value in (LOOP | {"c": 5.0}).items():
        low, high = model.intervals[name]
        assert abs(model.parameters[name] - value) <= 1.5 * (high - low), name


def _release(rest: Equilibrium, static: float, lift: float, seed: int) -> PistonRecord:
    """Record of a bed with friction that is lifted from its equilibrium [D], with noise."""
    changes: dict[str, Any] = {
        "arrangement": {"positions": rest.positions.tolist()},
        "piston.height": rest.piston_height,
        "effects.friction": {"static": static, "dynamic": 0.75 * static},
        "protocol": [
            {"kind": "lift", "name": "lift", "by": lift * D},
            {"kind": "free", "name": "release", "duration": 2.5},
        ],
        "output": {"scalars": "1 ms", "frames": "1 s", "record": "release"},
    }
    record = simulate(rest.scene.replace(**changes), progress=False).piston()
    noise = NOISE * np.random.default_rng(seed).normal(size=len(record))
    return PistonRecord(np.asarray(record.time), np.asarray(record.height) + noise)


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_release_from_half_the_lift(seed: int) -> None:
    rest = equilibrium(load_scene("damper").replace(**{"arrangement.seed": seed}))
    for static, lift in CASES:
        record, other = _release(rest, static, lift, 1), _release(rest, static, 0.5 * lift, 2)
        assert frequency_rises(record)
        displacement = math.sqrt(float(np.mean((np.asarray(other.height) - rest.piston_height) ** 2)))
        laws = (
            ("rubbing-bed", "bouc-wen", "viscous-coulomb")
            if seed == 1 and static != 0.1
            else ("rubbing-bed",)
        )
        own, *others = (roll_out(fit(record, law), other).error / displacement for law in laws)
        print(seed, static, own, others)
        assert own <= 0.05
        assert all(own <= left / 3.0 for left in others)
