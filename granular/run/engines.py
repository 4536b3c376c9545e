"""Engines: what advances a bed by ticks. Numba's compiled loop is the first.

An engine is a function ``advance(system, state, ticks) -> Rows``. It moves the state on in place, positions,
velocities, piston, clock and ledger, and returns a record of every so many ticks. An installed distribution
offers its own by an entry point of the group of `ENGINES`, and `granular.simulate` takes it by its name.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from granular.engine.columns import ledger_column_count
from granular.engine.step_size import StepSchedule
from granular.engine.tick_loop import StopCriteria, TickRange, advance_ticks
from granular.engine.time_step import StepPlan
from granular.kernel_data.state import Measurement, State
from granular.protocol.piston_motion import Motion
from granular.scene.scene_in_natural_units import SceneInNaturalUnits
from granular.shared.array_types import Float
from granular.shared.registry import Registry

NUMBA = "numba"
"""Name of the engine that is built in."""

NO_TICKS = TickRange(0.0, 0.0, math.inf, 0, 0)
"""Request of an engine to look at the present moment: one record, and nothing moves."""

UNDIVIDED = StepSchedule(1.0, 1.0, 1, 1, 1, 0)

UNWATCHED = StopCriteria(math.inf, -1.0, 0, np.zeros(3), np.zeros(3), 0.0, 0.0, -math.inf)


class Ticks(NamedTuple):
    """Ticks to advance by, in natural units."""

    window: TickRange  # which ones; none for a look at the present moment
    schedule: StepSchedule  # their steps, and how many there are from record to record
    tables: StepPlan  # the integration method
    motion: Motion  # of the piston
    measurement: Measurement  # workspace of the forces
    watch: StopCriteria  # what ends a call before its last tick, and what was seen


class Rows(NamedTuple):
    """Outcome of a call of an engine."""

    status: int  # why it returned: one of those in `granular.engine.tick_loop`
    done: int  # number of ticks
    records: Float[np.ndarray, "r columns"]  # of `granular.engine.columns`; the last row: the last tick


Engine = Callable[[SceneInNaturalUnits, State, Ticks], Rows]
"""A function that advances the state by ticks."""


def advance(system: SceneInNaturalUnits, state: State, ticks: Ticks) -> Rows:
    """Advance the state by ticks in the loop that Numba compiles."""
    window, schedule, tables, motion, measurement, watch = ticks
    rows = np.empty((window.ticks // schedule.every + 2, record_length(system)))
    status, done, saved = advance_ticks(
        window, schedule, tables, state, system.constants, motion, measurement, watch, rows
    )
    return Rows(status, done, rows[: saved + 1])


def record_length(system: SceneInNaturalUnits) -> int:
    """Count the columns of a record: of the energy ledger, of the effects' own values, and of the sides."""
    effects, own = system.effects, sum(len(effect.extra_records) for effect in system.effects)
    return ledger_column_count(len(effects)) + own + len(system.constants.acting.sides)


ENGINES = Registry[Engine](
    "engine", "granular.engines", {NUMBA: advance}, lambda _, engine: callable(engine), "a function"
)
"""Engines by their names."""
