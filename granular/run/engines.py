"""Engines, which advance a bed in time; the built-in engine is the loop that Numba compiles.

An engine is a function ``advance(system, state, ticks) -> TickOutcome``. A tick consists of several steps and
a measurement (`granular.engine`). The engine advances the state in place (positions, velocities, piston,
clock and energy balance) and returns records at a given interval of ticks. An installed distribution adds an
engine through an entry point in the group of `ENGINES`; `granular.simulate` selects the engine by name.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from granular.engine.columns import energy_ledger_column_count
from granular.engine.step_size import StepSchedule
from granular.engine.tick_loop import StopCriteria, TickRange, advance_ticks
from granular.engine.time_step import MethodTables
from granular.kernel_data.state import MeasurementScratchArrays, State
from granular.protocol.piston_motion import PistonMotion
from granular.scene.scene_in_natural_units import SceneInNaturalUnits
from granular.shared.array_types import Float
from granular.shared.registry import Registry

NUMBA = "numba"
"""Name of the built-in engine."""

NO_TICKS = TickRange(0.0, 0.0, math.inf, 0, 0)
"""Empty range of ticks, with which the loop only records the present state."""

UNDIVIDED = StepSchedule(1.0, 1.0, 1, 1, 1, 0)

NO_STOP_CRITERIA = StopCriteria(math.inf, -1.0, 0, np.zeros(3), np.zeros(3), 0.0, 0.0, -math.inf)


class TickRequest(NamedTuple):
    """Request to advance the bed by a number of ticks, in natural units."""

    window: TickRange  # range of ticks; empty for a record of the present moment
    schedule: StepSchedule  # steps per tick, and ticks between records
    tables: MethodTables  # the integration method
    motion: PistonMotion  # prescribed motion of the piston
    measurement: MeasurementScratchArrays  # workspace of the forces
    watch: StopCriteria  # criteria that end a call before its last tick, and monitored extremes


class TickOutcome(NamedTuple):
    """Result of one call to an engine."""

    status: int  # reason for the return, a code of `granular.engine.tick_loop`
    done: int  # number of ticks done
    records: Float[
        np.ndarray, "r columns"
    ]  # columns as in `granular.engine.columns`; the last row is the record of the last tick


Engine = Callable[[SceneInNaturalUnits, State, TickRequest], TickOutcome]
"""Function that advances the state by ticks."""


def advance_with_compiled_loop(system: SceneInNaturalUnits, state: State, ticks: TickRequest) -> TickOutcome:
    """Advance the state by ticks, using the loop that Numba compiles."""
    window, schedule, tables, motion, measurement, watch = ticks
    rows = np.empty((window.ticks // schedule.every + 2, record_column_count(system)))
    status, done, saved = advance_ticks(
        window, schedule, tables, state, system.constants, motion, measurement, watch, rows
    )
    return TickOutcome(status, done, rows[: saved + 1])


def record_column_count(system: SceneInNaturalUnits) -> int:
    """Count the columns of a record: energy balance, values of effects, and forces on the cell's sides."""
    effects, own = system.effects, sum(len(effect.extra_records) for effect in system.effects)
    return energy_ledger_column_count(len(effects)) + own + len(system.constants.acting.sides)


ENGINES = Registry[Engine](
    "engine",
    "granular.engines",
    {NUMBA: advance_with_compiled_loop},
    lambda _, engine: callable(engine),
    "a function",
)
"""Engines by name."""
