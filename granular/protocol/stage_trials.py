"""Functions of stages, tried before a run: one that fails hours later would lose these."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence

import numpy as np

from granular.protocol.driven_piston_stages import Hold, Lift
from granular.protocol.stage import SampledStage, Stage
from granular.schema.field_kinds import FieldError
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError
from granular.shared.message_text import quote


def try_stages(protocol: Sequence[Stage], height: float, scales: Scales) -> None:
    """Raise the errors of all stages that are functions of time; height of the piston at the start [m]."""
    known = True  # the height that a stage begins at; after a free stage only the run tells it
    for stage in protocol:
        height += stage.initial_jump(height) if known else 0.0
        if isinstance(stage, SampledStage):
            with name_stage_in_errors(stage, "tried before the run"):
                if known or stage.needs_piston_mass:
                    end = stage.motion(height, scales).heights[-1] * scales.length
                elif not np.isfinite(stage.sample_values(np.zeros(1), height)[0]):
                    raise FieldError("is not finite at the stage's start", stage.driven_quantity)
            known = known and not stage.needs_piston_mass
            height = float(end) if known else height
            continue
        final = stage.prescribed_final_height()
        known = (known and isinstance(stage, Hold | Lift)) or (final is not None and not stage.ends_at_force)
        height = height if final is None else final


@contextlib.contextmanager
def name_stage_in_errors(stage: Stage, when: str) -> Iterator[None]:
    """Put the name of a stage and a time in front of errors within the block."""
    try:
        yield
    except InputError as error:
        raise InputError(f"stage {quote(stage.name)}, {when}: {error}") from None
