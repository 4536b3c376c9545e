"""The time step of a stage: given by the user, or a fraction of the stiffest mode's period."""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from granular.compiled import compiled

FRACTION, LEAST_FRACTION = 0.1, 0.03
"""Automatic step times the highest angular frequency. Verlet is stable below 2; at 0.1 its error
in the frequency of that mode is 0.1^2/24 = 0.04 %, and less in every slower one; the ledger of the
packaged damper closes to 1e-5 of the energy turned over (to 3e-5 at 0.2). The error that one
collision leaves in the ledger for its duration, some 0.04 (fraction)^2 of its energy, counts for
more where fewer grains share the energy: below 368 grains the fraction falls with the square root
of their number, down to 0.03."""

DRY_FACTOR = 4.0
"""Factor of automatic steps where grains rub by the velocity scheme.

The motion of such a bed depends on its start far more than on the step: from 1e-4 to 1e-3 s the
piston force of a full compression of 368 grains stays within the 2 % by which starts scatter it; at
this factor, about 7e-4 s, the ledger is off by 4e-6 of the energy turned over."""

SLACK = 2.0
"""An automatic step is shortened as soon as it is this much too long."""

LONGEST = 8.0
"""Largest multiple of the automatic step that may be asked for, still short of instability."""

LOOK = 32
"""Most steps from look to look at the bed when a stage begins."""

REVIEW = 256
"""Ticks after which an automatic step is lengthened again, where the scene dissipates. A
conservative run keeps its energy because its step is shortened a few times at most."""


MOST_STEPS = 1e10
"""Most steps from record to record: a quarter of an hour and more without a sign of life, and
still far from where products of two such counts pass 64 bits."""

MOST_COUNT = 2**53
"""Steps, and ticks, beyond which floating-point numbers no longer count one by one."""


def auto_step_text(factor: float) -> str:
    """Multiple of the automatic step, as users write it: ``auto/2``."""
    if factor == 1.0:
        return "auto"
    sign, ratio = ("*", factor) if factor > 1.0 else ("/", 1.0 / factor)
    return f"auto{sign}{np.format_float_positional(ratio, trim='-')}"


@dataclasses.dataclass(frozen=True)
class StepRequest:
    """Requested time step."""

    seconds: float | None = None  # None: automatic [s]
    factor: float = 1.0  # of the automatic step
    grains: int = 368  # number of grains
    dry: bool = False  # grains rub by the velocity scheme, and nothing stiffer acts

    @property
    def automatic(self) -> bool:
        """True where no length is given."""
        return self.seconds is None

    @property
    def shortening_threshold(self) -> float:
        """Step times highest frequency at which the loop is to stop and shorten the step."""
        return SLACK * self.step_times_frequency if self.automatic else math.inf

    @property
    def step_times_frequency(self) -> float:
        """Automatic step times highest frequency."""
        portion = FRACTION * math.sqrt(self.grains / 368.0)
        factor = self.factor * (DRY_FACTOR if self.dry else 1.0)
        return factor * min(max(portion, LEAST_FRACTION), FRACTION)

    @property
    def greatest_factor(self) -> float:
        """Largest multiple of the automatic step that is allowed."""
        return LONGEST / DRY_FACTOR if self.dry else LONGEST

    def steps_per_tick(self, length: float, frequency: float) -> int:
        """Automatic steps of a tick, for a highest frequency; length [tau], frequency [1/tau]."""
        # 1e-9: rounding of a ratio that is a whole number makes no further step.
        return max(1, math.ceil(length * frequency / self.step_times_frequency - 1e-9))

    def divide_stage(self, record: float, frame: float, frequency: float, tau: float) -> StepSchedule:
        """Divide a stage into ticks and steps; record, frame [tau], frequency [1/tau], tau [s]."""
        if self.seconds is not None:
            h = self.seconds / tau
            steps = max(1, round(record / h))
            every = -(-steps // LOOK)
            frames = max(1, round(frame / (steps * h)))
            return StepSchedule(steps * h / every, h, every, _limit_tick_count(every * frames), LOOK, steps)
        every = -(-self.steps_per_tick(record, frequency) // LOOK)
        length = record / every
        steps = self.steps_per_tick(length, frequency)
        frames = max(1, round(frame / record))
        return StepSchedule(length, length / steps, every, _limit_tick_count(every * frames), steps, 0)


def _limit_tick_count(ticks: int) -> int:
    """Count that fits into a word; what lies farther than any run goes may lie nearer."""
    return min(ticks, MOST_COUNT)


class StepSchedule(NamedTuple):
    """Ticks and steps of a stage, as the compiled loop takes them."""

    length: float  # a tick [tau]; the mean one of a given step
    h: float  # a step [tau]
    every: int  # ticks from record to record
    frames_every: int  # ticks from frame to frame
    steps: int  # of a tick
    given: int  # steps from record to record of a given step; 0: automatic

    def with_steps(self, steps: int) -> StepSchedule:
        """Return the same ticks with another automatic step."""
        return self._replace(steps=steps, h=self.length / steps)


@compiled
def tick_start_time(schedule: StepSchedule, tick: int) -> float:
    """Time from the stage's start to a tick's start [tau]."""
    if schedule.given > 0:
        return steps_before_tick(schedule, tick) * schedule.h
    return tick * schedule.length


@compiled
def steps_before_tick(schedule: StepSchedule, tick: int) -> int:
    """Return the number of given steps from the stage's start to a tick's start."""
    # tick * given // every, whose product may pass 64 bits.
    total, part = tick // schedule.every, tick % schedule.every
    return total * schedule.given + part * schedule.given // schedule.every


@compiled
def steps_in_tick(schedule: StepSchedule, tick: int) -> int:
    """Return the number of steps of a tick."""
    if schedule.given > 0:
        return steps_before_tick(schedule, tick + 1) - steps_before_tick(schedule, tick)
    return schedule.steps


def completed_ticks(schedule: StepSchedule, time: float) -> float:
    """Return the number of ticks that end by a time in the stage; time [tau]."""
    if math.isinf(time):
        return math.inf
    if schedule.given > 0:
        steps = math.floor(time / schedule.h + 1e-6)
        return ((steps + 1) * schedule.every - 1) // schedule.given
    return math.floor(time / schedule.length + 1e-6)
