"""What the loop looks out for in a stage."""

from __future__ import annotations

import math

from granular.engine.loop import Watch
from granular.engine.step_size import MOST_COUNT
from granular.protocol.stage import Timed
from granular.run.standing import Standing

REST_TOLERANCE = 1e-4
"""Rest where the stage gives no tolerance [D], [D/tau]."""


def rest_limit(run: Standing) -> float:
    """What moves less is at rest [D], [D/tau]; negative where the stage does not end so."""
    stage = run.stage
    if not isinstance(stage, Timed) or stage.until != "rest":
        return -1.0
    if stage.tolerance is None:
        return REST_TOLERANCE
    return stage.tolerance / run.system.scales.length


def watch_of(run: Standing) -> Watch:
    """For the present stage of a run."""
    stage, pace, scales = run.stage, run.pace, run.system.scales
    rest, window = rest_limit(run), 0
    if isinstance(stage, Timed) and rest >= 0.0:
        window = math.ceil(min(stage.window / scales.time / pace.length, MOST_COUNT))
    stiff = run.step.stiff if run.plan.fraction is None else math.inf
    assert run.ledger is not None
    potential, piston = run.ledger.potential, run.ledger.piston
    floor = -math.inf if run.scene.piston is None else 0.0
    return Watch(stiff, rest, window, run.band, run.seen, potential, piston, floor)
