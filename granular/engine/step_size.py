"""The time step of a stage: given by the user, or a fraction of the stiffest mode's period."""

from __future__ import annotations

import dataclasses
import math

FRACTION = 0.1
"""Automatic step times the highest angular frequency. Verlet is stable below 2; at 0.1 its error
in the frequency of that mode is 0.1^2/24 = 0.04 %, and less in every slower one; the ledger of the
packaged damper closes to 1e-5 of the energy turned over (to 3e-5 at 0.2)."""

SLACK = 2.0
"""An automatic step is shortened as soon as it is this much too long."""

LONGEST = 8.0
"""Largest multiple of the automatic step that may be asked for, still short of instability."""

LOOK = 16
"""Most steps from look to look at the bed when a stage begins with an automatic step."""

REVIEW = 256
"""Ticks after which an automatic step is lengthened again, where the scene dissipates. A
conservative run keeps its energy because its step is shortened a few times at most."""


@dataclasses.dataclass(frozen=True)
class Step:
    """The time step that is asked for.

    Attributes
    ----------
    seconds : float or None
        None for the automatic step.
    factor : float
        Multiple of the automatic step.
    """

    seconds: float | None = None
    factor: float = 1.0

    @property
    def automatic(self) -> bool:
        return self.seconds is None

    @property
    def stiff(self) -> float:
        """Step times highest frequency at which the loop is to stop and shorten the step."""
        return SLACK * FRACTION * self.factor if self.automatic else math.inf

    def steps_of(self, length: float, frequency: float) -> int:
        """Automatic steps of a tick of that length [tau], for a highest frequency [1/tau]."""
        return max(1, math.ceil(length * frequency / (FRACTION * self.factor) - 1e-9))

    def pace(self, record: float, frame: float, frequency: float, tau: float) -> Pace:
        """How to cut a stage, for records and frames at those distances [tau].

        A given step stays as it is, and the distances are rounded to whole steps; an automatic
        one divides them.
        """
        if self.seconds is not None:
            dt = self.seconds / tau
            steps = max(1, round(record / dt))
            return Pace(steps * dt, 1, max(1, round(frame / (steps * dt))), steps)
        every = -(-self.steps_of(record, frequency) // LOOK)
        length = record / every
        frames_every = every * max(1, round(frame / record))
        return Pace(length, every, frames_every, self.steps_of(length, frequency))


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
