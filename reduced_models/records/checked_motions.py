"""Motions of a check's run; the process that runs it imports nothing of the fits, which take seconds."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from granular.shared.errors import RecordError

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory

RECORD, FALL = "record", "fall"
"""Names of what `piston_record_columns` gives."""


def piston_record_columns(run: Trajectory) -> Mapping[str, Any]:
    """Piston's record of a run, and of its first stage if that is a free motion, as columns [s, m]."""
    from granular.protocol.free_piston_stages import Free

    motions = {RECORD: run.piston()}
    first = run.scene.protocol[0]
    if isinstance(first, Free) and first.name != run.scene.output.record:
        with contextlib.suppress(RecordError):
            motions[FALL] = run.piston(first.name)
    return {
        name: {column: values.tolist() for column, values in motion.columns.items()}
        for name, motion in motions.items()
    }
