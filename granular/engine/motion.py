"""Where a piston that is not free stands: its path as a function of the time in the stage."""

from __future__ import annotations

from typing import NamedTuple

from granular.compiled import compiled


class Motion(NamedTuple):
    """How the piston moves during a stage.

    Attributes
    ----------
    free : bool
        Under its weight and the grains' force; otherwise along the path.
    start, speed : float
        The path: height at the stage's start [D], velocity [D/tau].
    """

    free: bool
    start: float
    speed: float


@compiled
def path(motion: Motion, time: float) -> tuple[float, float]:
    """Height and velocity of a driven piston at the time in the stage."""
    return motion.start + motion.speed * time, motion.speed
