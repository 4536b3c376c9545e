"""How a stage is cut into ticks and steps."""

from __future__ import annotations

import math

import numpy as np

from granular.engine import columns
from granular.engine.failures import countless
from granular.engine.step_size import MOST_COUNT, MOST_STEPS, Pace
from granular.engine.stiffness import collision_frequency
from granular.engine.variable import open_density
from granular.kernel_data.state import HEIGHT, LONGEST, SHORTEST, SPEED
from granular.protocol.motion import drive_frequency, greatest_speed
from granular.run.standing import Standing

DECAY_LIMIT = 10.0
"""A decay by drag is resolved as far as it is at most this much faster than the stiffest mode (or
than one that a step from record to record would resolve): a faster one leaves grains that creep,
which the exact flow of drag carries at any step."""


def set_pace(run: Standing, row: np.ndarray) -> None:
    """Cut the stage into ticks, by the speeds that the bed can reach from its start."""
    output, scales = run.scene.output, run.system.scales
    gravity = run.system.pull
    # A grain may still gain what it loses in height.
    top = float(run.state.y[: run.constants.grains].max(initial=0.0))
    speed = math.sqrt(row[columns.FASTEST] ** 2 + 2.0 * gravity * top)
    height, falling = run.state.piston[HEIGHT], run.state.piston[SPEED]
    speed += greatest_speed(run.motion, run.constants.piston_mass, gravity, height, falling)
    speed += sum(one.greatest_speed(scales) for one in run.system.effects)
    frequency = max(float(row[columns.STIFFEST]), collision_frequency(run.constants, speed))
    pace = run.step.pace(
        output.scalars / scales.time,
        output.frames / scales.time,
        _resolved(run, frequency),
        scales.time,
    )
    _use(run, pace)
    end = min(run.total, run.t_end - run.progress.start)
    _check_count(run, "the way to the end", end / pace.h if end < math.inf else 0.0, MOST_COUNT)
    if run.plan.fraction is not None:
        open_density(speed, 0.5 * pace.length, run.plan.fraction, run.state, run.constants)


def _check_count(run: Standing, what: str, steps: float, limit: float) -> None:
    if not steps <= limit:
        seconds = run.time * run.system.scales.time
        raise countless(what, steps, limit, run.steps, seconds)


def _resolved(run: Standing, frequency: float) -> float:
    """The frequency that an automatic step is to resolve, with the drive and the drag."""
    scales, effects = run.system.scales, run.system.effects
    rate = max((one.decay_rate(scales) for one in effects), default=0.0)
    record = run.scene.output.scalars / scales.time
    slowest = max(frequency, run.step.fraction / record)
    drive = max([drive_frequency(run.motion), *(one.drive_frequency(scales) for one in effects)])
    resolved = max(frequency, drive, min(rate, DECAY_LIMIT * slowest))
    steps = record * resolved / run.step.fraction
    if run.step.automatic:
        _check_count(run, "the time from record to record", steps, MOST_STEPS)
    return resolved


def _use(run: Standing, pace: Pace) -> None:
    run.progress.pace = list(pace)
    if run.plan.fraction is None:
        clock = run.state.clock
        clock[SHORTEST] = min(clock[SHORTEST], pace.h)
        clock[LONGEST] = max(clock[LONGEST], pace.h)


def set_steps(run: Standing, frequency: float) -> None:
    """Cut the ticks into steps that resolve another frequency; a variable step does so itself."""
    if run.plan.fraction is None:
        steps = run.step.steps_of(run.pace.length, _resolved(run, frequency))
        _use(run, run.pace.with_steps(steps))
