"""Which frames of a run are drawn."""

from __future__ import annotations

import math

import numpy as np

from granular.run.trajectory import Trajectory
from granular.shared.errors import InputError


def frame_number(run: Trajectory, frame: int = -1, time: float | None = None) -> int:
    """The index of a frame by its number (negative: from the end), or nearest to a time [s].

    Raises
    ------
    InputError
        If the run has no such frame, or does not reach the time.
    """
    times = run.dataset["frame_time"].values
    if time is not None:
        if not (math.isfinite(time) and times[0] <= time <= times[-1]):
            raise InputError(
                f"time {time:g} s is not in the run; it has frames from {times[0]:g} to "
                f"{times[-1]:g} s"
            )
        return int(np.abs(times - time).argmin())
    if not -len(times) <= frame < len(times):
        raise InputError(
            f"there is no frame {frame}; the run has {len(times)}: give 0 to {len(times) - 1}, or "
            f"-{len(times)} to -1 to count from the end"
        )
    return frame % len(times)


def stage_frames(run: Trajectory, stage: str | None) -> list[int]:
    """Indices of the frames of a stage, or of the whole run.

    Raises
    ------
    RecordError
        If the run has no such stage.
    InputError
        If no frame lies in it.
    """
    times = run.dataset["frame_time"].values
    if stage is None:
        return list(range(len(times)))
    chosen = run.stage(stage)
    inside = np.flatnonzero((times >= chosen.start) & (times <= chosen.end))
    if not len(inside):
        raise InputError(
            f"stage {stage!r} lasts {chosen.end - chosen.start:g} s and has no frame; lower "
            "output.frames, or leave the stage out"
        )
    return [int(one) for one in inside]
