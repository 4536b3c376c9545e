"""What is left of a run: its steps, and the length of its stages."""

from __future__ import annotations

import math

from granular.protocol.stage import Timed
from granular.run.run import Run


def steps_ahead(run: Run) -> float:
    """Steps from here to the end of a run, at the present one.

    A stage that ends at rest or at a force counts whole, and a later one from the height that the
    piston has now.
    """
    progress, protocol = run.progress, run.scene.protocol
    if run.finished or not progress.begun:
        return 0.0
    last = protocol[-1]
    spans = [stage.span(progress.height) or 0.0 for stage in protocol[progress.stage + 1 :]]
    end = progress.start + run.total + math.fsum(spans) / run.system.scales.time
    end = min(end, run.t_end)
    if isinstance(last, Timed) and last.until is None and math.isfinite(run.t_end):
        end = run.t_end  # such a stage is lengthened up to it
    return max(0.0, end - run.time) / run.pace.h


def expected_seconds(run: Run) -> float | None:
    """Length of the present stage [s], as far as it is known."""
    stage = run.scene.protocol[run.progress.stage]
    if isinstance(stage, Timed) and stage.until == "rest":
        return None
    end = min(run.total, run.t_end - run.progress.start)
    return end * run.system.scales.time if math.isfinite(end) else None
