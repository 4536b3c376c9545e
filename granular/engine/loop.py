"""The loop: kicks and drifts from a table, over ticks that end with a measurement.

A tick is the span between two looks at the bed. At its end the loop takes the energies, the
stiffest mode and the speeds in the pass that the step needs anyway, watches for rest, for a force
that is reached, for grains that leave and for steps that grew too long, and keeps a record every
so many ticks.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.engine.forces import (
    compute_forces,
    kinetic_energy,
    measure_forces,
    potential_energies,
)
from granular.engine.kick import kick_grains
from granular.engine.motion import Motion
from granular.engine.piston import drift_piston, kick_piston, piston_energy
from granular.engine.state import Measurement, State
from granular.engine.stiffness import stiffest_mode
from granular.engine.system import Constants

RUNNING, OUTSIDE, RESTING, STIFF, REACHED, LEFT = range(6)

COLUMNS = (
    "time",
    "height",
    "velocity",
    "left",
    "right",
    "bottom",
    "top",
    "kinetic",
    "pair",
    "wall",
    "weight",
    "contact",
    "piston",
    "work",
    "drag_loss",
    "friction_loss",
    "contact_loss",
    "piston_loss",
    "closest",
    "fastest",
    "stiffest",
    "grains",
)
"""One record: time; the piston; the force on each wall; the energies; the ledger; the least
distance of two grains, the greatest speed, and the bound of the highest angular frequency that the
bed can meet; the number of grains."""

CLOSEST, FASTEST, STIFFEST = (COLUMNS.index(name) for name in ("closest", "fastest", "stiffest"))
_LEDGER = COLUMNS.index("work")


class Watch(NamedTuple):
    """What the loop looks out for at every tick.

    Attributes
    ----------
    stiff : float
        Stop as soon as the step times the highest angular frequency exceeds this.
    rest : float
        The piston is at rest while its height stays in a band of this width [D], and the grains
        while none is faster than this [D/tau]. Negative: rest is not looked for.
    window : int
        Ticks that the rest must last.
    band : float64 (3,)
        Memory: the tick at which the present band began, and its bounds.
    seen : float64 (2,)
        Memory: highest angular frequency since it was last cleared, and the last one.
    """

    stiff: float
    rest: float
    window: int
    band: np.ndarray
    seen: np.ndarray


@compiled
def _drift(
    span: float, state: State, constants: Constants, motion: Motion, time: float, start: float
) -> None:
    """Positions after ``span``, which ends at ``time`` in the stage."""
    for i in range(constants.grains):
        state.x[i] += span * state.vx[i]
        state.y[i] += span * state.vy[i]
    drift_piston(span, state, constants, motion, time, start)


@compiled
def _step(
    h: float,
    time: float,
    start: float,
    kicks: Array,
    drifts: Array,
    state: State,
    constants: Constants,
    motion: Motion,
    measurement: Measurement | None,
) -> int:
    """One step from ``time`` in the stage; the last forces are measured if asked."""
    outside = 0
    stage = time
    stages = drifts.size
    for k in range(stages + 1):
        if kicks[k] != 0.0:
            opening = 2 * k < stages
            kick_grains(kicks[k] * h, state, constants, opening)
            kick_piston(kicks[k] * h, state, constants, motion, stage, start, opening)
        if k < stages:
            stage += drifts[k] * h
            _drift(drifts[k] * h, state, constants, motion, stage, start)
            last = k == stages - 1
            if last and measurement is not None:
                outside += measure_forces(state, constants, start + stage, measurement)
            elif not last or kicks[stages] != 0.0:
                outside += compute_forces(state, constants, start + stage)
    return outside


@compiled
def measure(
    time: float,
    state: State,
    constants: Constants,
    motion: Motion,
    measurement: Measurement,
    row: Array,
) -> None:
    """Fill one record after a measuring pass, at a time [tau]."""
    kinetic, fastest = kinetic_energy(state, constants)
    pair, wall, weight, touching = potential_energies(state, constants, time, measurement)
    row[0] = time
    row[1] = state.piston[0]
    row[2] = state.piston[1]
    for side in range(4):
        row[3 + side] = state.totals[side]
    row[7] = kinetic
    row[8] = pair
    row[9] = wall
    row[10] = weight
    row[11] = touching
    row[12] = piston_energy(state, constants, time)
    for entry in range(state.ledger.size):
        row[_LEDGER + entry] = state.ledger[entry]
    row[CLOSEST] = measurement.extremes[1] ** -0.2 if measurement.extremes[1] > 0.0 else math.inf
    row[FASTEST] = math.sqrt(fastest)
    row[STIFFEST] = stiffest_mode(row[FASTEST], state, constants, motion, measurement)
    row[STIFFEST + 1] = constants.grains


@compiled
def _anyone_below(y: Array, count: int, height: float) -> bool:
    for i in range(count):  # noqa: SIM110 (a loop is what compiles)
        if y[i] < height:
            return True
    return False


@compiled
def _resting(watch: Watch, tick: int, row: Array) -> bool:
    """Whether piston and grains have been at rest for the window."""
    height = row[1]
    watch.band[1] = min(watch.band[1], height)
    watch.band[2] = max(watch.band[2], height)
    if watch.band[2] - watch.band[1] > watch.rest or row[FASTEST] > watch.rest:
        watch.band[0] = tick
        watch.band[1] = height
        watch.band[2] = height
    return tick - watch.band[0] >= watch.window


@compiled
def advance(
    ticks: int,
    first_tick: int,
    length: float,
    steps: int,
    h: float,
    start: float,
    record_every: int,
    kicks: Array,
    drifts: Array,
    state: State,
    constants: Constants,
    motion: Motion,
    measurement: Measurement,
    watch: Watch,
    rows: Array,
) -> tuple[int, int, int, int]:
    """Advance by up to ``ticks`` ticks.

    Parameters
    ----------
    ticks, first_tick : int
        How many, and the index of the first in its stage.
    length : float
        A whole tick [tau].
    steps, h : int, float
        Steps of a tick, and the time step [tau].
    start : float
        Time at the start of the stage [tau].
    record_every : int
        Ticks from record to record.
    rows : float64 (r, len(COLUMNS))
        Filled with the records; the row behind them holds the last tick.

    Returns
    -------
    tuple of int
        Status; ticks made; records written; steps made in an unfinished tick.
    """
    kept = 0
    for tick in range(first_tick, first_tick + ticks):
        begin = tick * length
        for step in range(steps):
            time = begin + step * h
            if step == steps - 1:
                outside = _step(
                    h, time, start, kicks, drifts, state, constants, motion, measurement
                )
            else:
                outside = _step(h, time, start, kicks, drifts, state, constants, motion, None)
            if outside > 0:
                return OUTSIDE, tick - first_tick, kept, step + 1
        row = rows[kept]
        done = tick + 1
        # A short tick at the end of a stage has shorter steps than its length says.
        end = start + min(done * length, begin + steps * h)
        measure(end, state, constants, motion, measurement, row)
        watch.seen[0] = max(watch.seen[0], row[STIFFEST])
        watch.seen[1] = row[STIFFEST]
        resting = watch.rest >= 0.0 and _resting(watch, done, row)
        if done % record_every == 0:
            kept += 1
        if resting:
            return RESTING, done - first_tick, kept, 0
        if state.totals[3] >= motion.limit:
            return REACHED, done - first_tick, kept, 0
        if _anyone_below(state.y, constants.grains, constants.exit):
            return LEFT, done - first_tick, kept, 0
        if row[STIFFEST] * h > watch.stiff:
            return STIFF, done - first_tick, kept, 0
    return RUNNING, ticks, kept, 0
