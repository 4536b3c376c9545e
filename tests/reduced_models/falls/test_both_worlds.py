"""One set of numbers for a bed that falls, is lifted at rest, or is shaken."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import PistonRecord, Scene, damper, simulate
from reduced_models.falls.predicted_law import RESPONSE_ERROR
from reduced_models.laws.annealing_bed import MODULUS, STRENGTH
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.equation import compile_rates
from reduced_models.laws.solution import solve_law
from tests.reduced_models.falls.pushed import PUSHED, Pushed

D = 0.006
LAW = LAWS["annealing-bed"]
LIFTS = (0.2, 0.7, 1.5, 2.5, 4.0)
FALLS = (14.0, 16.0, 18.0, 20.0, 24.0, 28.0)
AMPLITUDES, FREQUENCIES = (0.5, 1.5, 3.0), (1.0, 3.5, 8.0)
SETTLE = {"kind": "free", "name": "fall", "until": "rest"}


def run(scene: Scene, height: float, *stages: dict[str, Any]) -> list[PistonRecord]:
    """The record of each stage that takes time, from a height [D, for 368 grains]."""
    changes = {
        "piston.height": height * scale(scene),
        "arrangement.height": (height - 1.0) * scale(scene),
        "output.record": None,
        "protocol": list(stages),
    }
    found = simulate(scene.replace(**changes), dt="auto*2", progress=False)
    return [found.piston(str(one["name"])) for one in stages if one["kind"] != "lift"]


def numbers(scene: Scene, rest: float) -> list[float]:
    """Theory's weight, power and drag; modulus and strength are the same for all beds."""
    assert scene.piston is not None
    assert scene.effects.drag is not None
    lam = scene.grains.count * scene.effects.drag.coefficient / (6.0 * scene.piston.mass)
    known = {"lam": lam, "weight": 9.8, "rest": rest, "power": 2.5, "modulus": MODULUS, "strength": STRENGTH}
    return [known[name] for name in LAW.parameters]


def strained(values: list[float], hidden: list[float], times: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """Hidden states (2, n) along straight lines from height to height, by the midpoint rule."""
    rates = compile_rates(LAW.equation, (), "numpy")
    states = np.empty((2, len(times)))
    states[:, 0] = hidden
    steps = np.diff(times)
    speeds, middles = np.diff(heights) / steps, 0.5 * (heights[1:] + heights[:-1])
    for k, (step, speed, middle) in enumerate(zip(steps, speeds, middles, strict=True)):
        half = states[:, k] + 0.5 * step * np.array(rates(middle, speed, *states[:, k], *values)[1:])
        states[:, k + 1] = states[:, k] + step * np.array(rates(middle, speed, *half, *values)[1:])
    return states


def rms(record: PistonRecord, values: list[float], hidden: list[float], rest: float) -> float:
    """Of the law's motion from the first height on, over how far that is from rest."""
    first = float(record.height[0])
    time = record.time - record.time[0]
    found = solve_law(LAW, time, first, 0.0, values, first - rest, hidden=hidden).z
    return float(np.sqrt(np.mean((found - record.height) ** 2)) / (first - rest))


def lifted(values: list[float], hidden: list[float], rest: float, height: float) -> list[float]:
    """Hidden states of a bed that has followed a lift, so fast that no order could grow."""
    instant = np.linspace(0.0, 1e-6, 200)
    return list(strained(values, hidden, instant, np.linspace(rest, height, 200))[:, -1])


def work(record: PistonRecord, force: np.ndarray, frequency: float) -> float:
    """Taken by the bed in a cycle behind the first [J]."""
    time = record.time - record.time[0]
    kept = time >= 1.0 / frequency - 1e-9
    cycles = round(float(time[-1]) * frequency) - 1
    return -float(np.trapezoid(force[kept], record.height[kept])) / cycles


FREE = {"kind": "free", "name": "free", "duration": 3.0}


def scale(scene: Scene) -> float:
    return math.sqrt(scene.grains.count / 368) * D


def lift(scene: Scene, by: float) -> list[PistonRecord]:
    """A fall from 20 D to rest, and what follows a lift."""
    stage = {"kind": "lift", "name": "lift", "by": by * scale(scene)}
    return run(scene, 20.0, SETTLE, stage, FREE)


def settled(scene: Scene, record: PistonRecord) -> tuple[float, list[float], list[float]]:
    """Level of rest, numbers of the law and hidden states after a fall."""
    rest = float(record.height[-1])
    values = numbers(scene, rest)
    states = strained(values, [0.0, 0.0], record.time - record.time[0], record.height)
    return rest, values, list(states[:, -1])


def lift_error(scene: Scene, by: float) -> float:
    before, record = lift(scene, by)
    rest, values, hidden = settled(scene, before)
    return rms(record, values, lifted(values, hidden, rest, float(record.height[0])), rest)


def loss_ratio(scene: Scene, amplitude: float, frequency: float) -> float:
    """Work that the law takes in a cycle of a prescribed sine, over that of the bed."""
    assert scene.piston is not None
    sine = {
        "kind": "oscillate",
        "name": "sine",
        "amplitude": amplitude * scale(scene),
        "frequency": frequency,
        "duration": max(4, math.ceil(frequency)) / frequency,
    }
    before, record = run(scene, 20.0, SETTLE, sine)
    _, values, hidden = settled(scene, before)
    time = record.time - record.time[0]
    states = strained(values, hidden, time, record.height)
    speed = np.gradient(record.height, time)
    field = compile_rates(LAW.equation, (), "numpy")
    force = scene.piston.mass * (9.8 + np.asarray(field(record.height, speed, *states, *values)[0]))
    assert record.force is not None
    return work(record, force, frequency) / work(record, record.force, frequency)


@pytest.mark.long  # quick: the law itself, tests/reduced_models/laws/test_annealing_bed.py
def test_a_fall_and_a_lift() -> None:
    scene = damper()
    before, record = lift(scene, 1.5)
    rest, values, hidden = settled(scene, before)
    fall = before.between(float(before.time[0]), float(before.time[0]) + 3.0)
    assert rms(fall, values, [0.0, 0.0], rest) <= 0.02
    assert rms(record, values, lifted(values, hidden, rest, float(record.height[0])), rest) <= 0.03


@pytest.mark.long
@pytest.mark.parametrize("count", [368, 736])
def test_one_set_of_numbers_for_falls_lifts_and_sines(count: int) -> None:
    scene = damper(count=count)
    (before,) = run(scene, 20.0, SETTLE)
    rest, values, _ = settled(scene, before)
    falls = [rms(run(scene, height, FREE)[0], values, [0.0, 0.0], rest) for height in FALLS]
    lifts = [lift_error(scene, by) for by in LIFTS]
    losses = [loss_ratio(scene, one, other) for one in AMPLITUDES for other in FREQUENCIES]
    print(f"\n{count}: falls", *(f"{100 * one:.2f}" for one in falls))
    print("lifts", *(f"{100 * one:.2f}" for one in lifts))
    print("loss", *(f"{one:.2f}" for one in losses))
    assert max(falls) <= 0.02
    assert max(lifts) <= 0.03
    assert all(abs(one - 1.0) <= 0.15 for one in losses)


def forces_at(
    mass: float, values: list[float], hidden: list[float], rest: float, row: Pushed
) -> tuple[np.ndarray, np.ndarray]:
    """Times and heights of the law of a piston that is pushed from its rest."""
    field = compile_rates(LAW.equation, (), "math")
    omega = 2.0 * math.pi * row.frequency

    def rates(t: float, state: np.ndarray) -> list[float]:
        z, v, *memory = map(float, state)
        acceleration, *changes = field(z, v, *memory, *values)
        return [v, acceleration + row.force / mass * math.sin(omega * t), *changes]

    duration = cycles(row) / row.frequency
    times = np.linspace(0.0, duration, round(400 * duration) + 1)
    found = solve_ivp(
        rates,
        (0.0, duration),
        [rest, 0.0, *hidden],
        "LSODA",
        times,
        rtol=1e-7,
        atol=1e-9,
        max_step=0.02 / row.frequency,
    )
    return times, found.y[0]


def cycles(row: Pushed) -> int:
    return max(6, math.ceil(2.0 * row.frequency))


def response(times: np.ndarray, heights: np.ndarray, frequency: float) -> float:
    """Half the range of the last three cycles [m]."""
    return 0.5 * float(np.ptp(heights[times > times[-1] - 3.0 / frequency - 1e-9]))


def test_the_law_responds_to_a_push_as_the_table_says() -> None:
    scene = damper()
    for row in (PUSHED[0], PUSHED[7], PUSHED[12]):
        # Level of rest and order of the simulated bed.
        times, heights = forces_at(7.5, numbers(scene, 0.05912), [0.00023, 0.9883], 0.05912, row)
        found = response(times, heights, row.frequency) / scale(scene)
        assert found == pytest.approx(row.by_law, rel=0.01)
        assert abs(row.by_law / row.simulated - 1.0) <= RESPONSE_ERROR


@pytest.mark.long  # quick: the law's side of it
@pytest.mark.parametrize("row", PUSHED)
def test_a_pushed_bed_responds_as_the_table_says(row: Pushed) -> None:
    scene = damper(count=row.grains)
    stage = {
        "kind": "push",
        "name": "push",
        "amplitude": row.force,
        "frequency": row.frequency,
        "duration": cycles(row) / row.frequency,
    }
    _, record = run(scene, 20.0, SETTLE, stage)
    found = response(record.time, record.height, row.frequency) / scale(scene)
    assert found == pytest.approx(row.simulated, rel=0.01)
