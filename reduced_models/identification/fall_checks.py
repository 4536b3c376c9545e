"""Falls of a scene that no law has seen: from other heights, and from other random starts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from granular.run.record import PistonRecord
from granular.shared.errors import GranularError, InputError, RecordError
from reduced_models.falls.data import Falls
from reduced_models.falls.judging import judged_falls
from reduced_models.identification.checks import CHECK_SEEDS, Failure, RunCheck

if TYPE_CHECKING:
    from collections.abc import Sequence

    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene

SHARES = (0.4, 0.6, 1.4, 1.8)
"""Of the drop's height, from which the piston falls instead."""
PERIODS = 10.0
"""Of the small swing, for which falls are followed: by then they have died out, or swing small."""
FEWEST = 100
"""Samples of a fall."""
STARTS = 8
"""Of each fit: a fall without noise, which few starts find, and the scene says where to begin."""
_STILL = 0.05  # of the drop: what falls less far is a nudge


def fall_of(run: Trajectory, period: float) -> PistonRecord | None:
    """The fall with which a run begins; None where it begins otherwise."""
    from granular.protocol.free import Free

    scene = run.scene
    if scene.piston is None or scene.effects.gravity is None or not scene.protocol:
        return None
    first = scene.protocol[0]
    if not isinstance(first, Free):
        return None
    try:
        record = run.piston(first.name)
    except RecordError:
        return None
    start = float(record.time[0])
    record = record.between(start, min(float(record.time[-1]), start + PERIODS * period))
    rest = run.stage(first.name).height
    falls = record.height[0] - rest > _STILL * rest
    return record if falls and len(record) >= FEWEST else None


def fall_checks(run: Trajectory, fall: PistonRecord) -> list[RunCheck]:
    """Runs of the fall alone, from other heights that the grains fit under, and other starts."""
    scene = run.scene
    assert scene.piston is not None
    first = scene.protocol[0]
    rest, height = run.stage(first.name).height, scene.piston.height
    grid = scene.arrangement.height
    stage = {"kind": "free", "name": first.name,
             "duration": float(fall.time[-1] - fall.time[0])}  # fmt: skip
    alone = {"protocol": [stage], "output.record": first.name}
    found = []
    for share in SHARES:
        other = rest + share * (height - rest)
        below = None if grid is None else other - (height - grid)
        changes = {**alone, "piston.height": other, "arrangement.height": below}
        found.append(RunCheck(f"from {1e3 * other:.0f} mm", changes))
    seed = scene.arrangement.seed + 1
    found += [
        RunCheck(f"start {k}", {**alone, "arrangement.seed": k})
        for k in range(seed, seed + CHECK_SEEDS)
    ]
    return [one for one in found if _fits(scene, one)]


def _fits(scene: Scene, check: RunCheck) -> bool:
    """Whether a scene can be changed so; grains may not fit under a lower piston."""
    try:
        scene.replace(**check.changes)
    except GranularError:
        return False
    return True


def falls_of(
    run: Trajectory,
    fall: PistonRecord,
    checks: Sequence[RunCheck],
    records: Sequence[PistonRecord | Failure],
) -> Falls | Failure:
    """The laws judged on the falls that could be run."""
    unseen = {
        check.what: record
        for check, record in zip(checks, records, strict=True)
        if isinstance(record, PistonRecord)
    }
    try:
        return judged_falls(
            fall, unseen, rest=run.stage(run.scene.protocol[0].name).height, scene=run.scene,
            starts=STARTS,
        )  # fmt: skip
    except InputError as cause:
        return Failure("other falls", str(cause))
