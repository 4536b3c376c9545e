"""How far a run has to go: in seconds, in steps, and by the clock."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from granular.protocol.stage import Timed

if TYPE_CHECKING:
    from granular.run.run import Run

LONG = 60.0
"""Length of a run [s], by the wall clock, from which on it is told at the start."""


def stage_seconds(run: Run) -> float | None:
    """Length of the present stage [s], as far as it is known."""
    stage = run.scene.protocol[run.progress.stage]
    if isinstance(stage, Timed) and stage.until == "rest":
        return None
    end = min(run.total, run.t_end - run.progress.start)
    return end * run.system.scales.time if math.isfinite(end) else None


def steps_ahead(run: Run) -> float:
    """Steps from here to the end of a run, at the present one.

    A stage that ends at rest or at a force counts whole, and a later one from the height that the
    piston has now.
    """
    progress, last = run.progress, run.scene.protocol[-1]
    if run.finished or not progress.begun:
        return 0.0
    later = run.scene.protocol[progress.stage + 1 :]
    spans = [stage.span(progress.height) or 0.0 for stage in later]
    end = min(progress.start + run.total + math.fsum(spans) / run.system.scales.time, run.t_end)
    if isinstance(last, Timed) and last.until is None and math.isfinite(run.t_end):
        end = run.t_end  # such a stage is lengthened up to it
    return max(0.0, end - run.time) / run.pace.h


def outlook(steps: float, rate: float) -> str | None:
    """How long so many steps take at a rate [1/s], in words; None where it is not long."""
    seconds = steps / rate
    if seconds < LONG:
        return None
    sizes = (("years", 3.156e7), ("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0))
    unit, size = next(one for one in sizes if seconds >= one[1])
    return f"up to {steps:.2g} steps, {seconds / size:.2g} {unit} at {rate:.2g} steps a second"
