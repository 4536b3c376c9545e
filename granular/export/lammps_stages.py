"""The stages of a protocol as LAMMPS formulas; stages that LAMMPS cannot represent are refused."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from granular.protocol import Descend, Follow, Lift, Move, Oscillate, Stage
from granular.protocol.stage import TimedStage
from granular.shared.errors import InputError


class PistonPath(NamedTuple):
    """Prescribed motion of the piston in a stage."""

    formula: str  # formula of its height [m] as a function of ``v_t``, the time since the stage's start [s]
    lowest: float  # minimum height [m]
    highest: float  # [m]
    end: float  # height at the end of the stage [m]
    speed: float  # maximum speed [m/s]


class RemainingStage(NamedTuple):
    """A stage of a protocol for LAMMPS; the stage may already have run for the time ``elapsed``."""

    name: str
    kind: str
    path: PistonPath | None
    elapsed: float  # [s]
    total_duration: float  # [s]

    @property
    def remaining_duration(self) -> float:
        """Time from now to the end of the stage [s]."""
        return max(0.0, self.total_duration - self.elapsed)


def convert_stage_for_lammps(stage: Stage, height: float | None, elapsed: float = 0.0) -> RemainingStage:
    """Convert a stage that has run for ``elapsed`` [s] to a form that LAMMPS can run; ``height`` is in m."""
    reason = None
    if stage.needs_piston_mass:
        reason = (
            "its piston is free, but LAMMPS needs a prescribed motion; use a stage of kind 'follow' or 'hold'"
        )
    elif isinstance(stage, TimedStage) and stage.until is not None:
        reason = f"it ends at {stage.until}, at an unknown time; give it a duration instead of 'until'"
    elif stage.ends_at_force:
        reason = "it ends at a force, at an unknown time; remove until_force"
    if reason is not None:
        raise InputError(f"stage {stage.name!r} cannot be exported to LAMMPS: {reason}")
    kind = type(stage).__name__.lower()
    duration = stage.maximum_duration(0.0 if height is None else height)
    if duration is None:
        raise InputError(f"stage {stage.name!r} has no end; give it a duration to export it to LAMMPS")
    path = None if height is None else _piston_path_of_stage(stage, height, duration)
    return RemainingStage(stage.name, kind, path, elapsed, duration)


def _piston_path_of_stage(stage: Stage, height: float, duration: float) -> PistonPath:
    if isinstance(stage, Move):
        speed = (stage.to - height) / duration if duration else 0.0
        formula = f"{height!r}+({speed!r})*v_t"
        low, high = sorted((height, stage.to))
        return PistonPath(formula, low, high, stage.to, abs(speed))
    if isinstance(stage, Descend):
        rate, total = stage.steepness / duration, math.expm1(stage.steepness)
        reach = (height - stage.to) / total
        formula = f"{height!r}-({reach!r})*(exp({rate!r}*v_t)-1.0)"
        speed = abs(reach) * rate * (total + 1.0)
        low, high = sorted((height, stage.to))
        return PistonPath(formula, low, high, stage.to, speed)
    if isinstance(stage, Oscillate):
        omega, reach = 2.0 * math.pi * stage.frequency, stage.amplitude
        formula = f"{height!r}+{reach!r}*sin({omega!r}*v_t)"
        end = height + reach * math.sin(omega * duration)
        return PistonPath(formula, height - reach, height + reach, end, reach * omega)
    if isinstance(stage, Follow):
        return _piston_path_of_follow(stage)
    if isinstance(stage, Lift):
        height += stage.by
    return PistonPath(repr(height), height, height, height, 0.0)


def _piston_path_of_follow(stage: Follow) -> PistonPath:
    """Return the piecewise linear path as a sum of ramps, each of which starts at a tabulated time."""
    times, heights = stage.times, stage.heights
    slopes = (np.diff(heights) / np.diff(times)).tolist()
    changes = np.diff([0.0, *slopes]).tolist()
    terms = [
        f"({change!r})*(v_t>{time!r})*(v_t-{time!r})" for change, time in zip(changes, times, strict=False)
    ]
    formula = "+".join([repr(heights[0]), *terms])
    fastest = max(map(abs, slopes))
    return PistonPath(formula, min(heights), max(heights), heights[-1], fastest)
