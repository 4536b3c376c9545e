"""The time step of a stage: given by the user, or a fraction of the stiffest mode's period."""

from __future__ import annotations

import dataclasses
import math

FRACTION = 0.1
"""Automatic step times the highest angular frequency. Verlet is stable below 2; at 0.1 its error
in the frequency of that mode is 0.1^2/24 = 0.04 %, and less in every slower one; the ledger of the
packaged damper closes to 1e-5 of the energy turned over (to 3e-5 at 0.2)."""

STIFF = 2.0 * FRACTION
"""An automatic step is shortened as soon as it exceeds this fraction."""

LOOK = 16
"""Most steps from look to look at the bed when a stage begins with an automatic step."""

REVIEW = 256
"""Ticks after which an automatic step is lengthened again, where the scene dissipates. A
conservative run keeps its energy because its step is shortened a few times at most."""


@dataclasses.dataclass(frozen=True)
class Pace:
    """How a stage is cut into ticks and steps.

    Attributes
    ----------
    length : float
        A tick [tau]: from look to look at the bed.
    every : int
        Ticks from record to record.
    frames_every : int
        Ticks from frame to frame.
    steps : int
        Steps of a tick.
    """

    length: float
    every: int
    frames_every: int
    steps: int

    @property
    def h(self) -> float:
        return self.length / self.steps


def steps_of(length: float, frequency: float) -> int:
    """Steps of a tick of that length [tau] for an automatic step."""
    return max(1, math.ceil(length * frequency / FRACTION - 1e-9))


def automatic_pace(record: float, frame: float, frequency: float) -> Pace:
    """Pace for records and frames at those distances [tau], from the highest frequency [1/tau]."""
    every = -(-steps_of(record, frequency) // LOOK)
    length = record / every
    frames_every = every * max(1, round(frame / record))
    return Pace(length, every, frames_every, steps_of(length, frequency))


def given_pace(record: float, frame: float, dt: float) -> Pace:
    """Pace for a given step [tau]; the distances are rounded to whole steps."""
    steps = max(1, round(record / dt))
    return Pace(steps * dt, 1, max(1, round(frame / (steps * dt))), steps)
