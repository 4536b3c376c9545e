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

from granular.compiled import Array, compiled, entry
from granular.engine.far import find_far_field, kick_by_far_field
from granular.engine.forces import kinetic_energy, measure_forces, potential_energies
from granular.engine.motion import Motion
from granular.engine.piston import piston_energy
from granular.engine.state import Measurement, State
from granular.engine.step import Plan, make_step
from granular.engine.step_size import Pace, tick_start, tick_steps
from granular.engine.stiffness import stiffest_mode
from granular.engine.system import Constants
from granular.engine.variable import LONGEST, SHORTEST, STEPS, TIME, next_step

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
    "turned",
)
"""One record: time; the piston; the force on each wall; the energies; the ledger; the least
distance of two grains, the greatest speed, and the bound of the highest angular frequency that the
bed can meet; the number of grains; the energy turned over so far."""

CLOSEST, FASTEST, STIFFEST = (COLUMNS.index(name) for name in ("closest", "fastest", "stiffest"))
TURNED = COLUMNS.index("turned")
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
    seen : float64 (3,)
        Memory: highest angular frequency since it was last cleared, and the last one; greatest
        energy turned over.
    potential, piston : float
        Potential energy, and energy of the piston, at the run's start [F* D].
    floor : float
        Lowest height of the piston [D].
    """

    stiff: float
    rest: float
    window: int
    band: np.ndarray
    seen: np.ndarray
    potential: float
    piston: float
    floor: float


@entry
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


class Window(NamedTuple):
    """Which ticks to advance by.

    Attributes
    ----------
    start : float
        Time at the start of the stage [tau].
    origin : float
        Time from there to tick 0 [tau].
    limit : float
        Time in the stage that variable steps do not pass [tau].
    first, ticks : int
        Index of the first tick, and how many.
    """

    start: float
    origin: float
    limit: float
    first: int
    ticks: int


@compiled
def _turned_over(watch: Watch, row: Array) -> float:
    """Energy turned over since the start; see `granular.engine.ledger.Ledger`."""
    potential = row[8] + row[9] + row[10] + row[11] - watch.potential
    lost = row[14] + row[15] + row[16] + row[17]
    return row[7] + abs(potential) + abs(row[12] - watch.piston) + lost + abs(row[13])


@compiled
def _make_tick(
    fraction: float | None, every: int | None, tick: int, window: Window, pace: Pace, plan: Plan,
    state: State, constants: Constants, motion: Motion, measurement: Measurement,
) -> int:  # fmt: skip
    """The steps of a tick; not zero where a grain is where it cannot be.

    Variable steps go up to the first moment behind the tick's end; the last one of a stage is cut.
    A far field that acts ``every`` so many steps gives its impulse half before and half after them
    (Tuckerman, Berne and Martyna 1992, doi:10.1063/1.463137); a tick is cut into such spans.
    """
    begin, end = window.origin + tick_start(pace, tick), window.origin + tick_start(pace, tick + 1)
    steps, step, time, h, last = tick_steps(pace, tick), 0, begin, pace.h, False
    span, spans, span_end, outside = 0, 1, 0, 0
    if every is not None:
        spans = (steps + every - 1) // every
    if fraction is not None:
        time = state.clock[TIME]
        end = min(end, window.limit)
        if time >= end:
            return measure_forces(state, constants, window.start + time, measurement)
    while not last:
        if every is not None and step == span_end:
            span += 1
            span_end = span * steps // spans
            impulse = 0.5 * (span_end - step) * h
            kick_by_far_field(state.far, impulse, state, constants)
        if fraction is None:
            time = begin + step * h
            step += 1
            last = step == steps
            next_time = end if last else time + h
        else:
            h = next_step(fraction, state, constants)
            next_time = time + h
            last = next_time >= end
            if next_time >= window.limit:
                h, next_time = window.limit - time, window.limit
            else:
                state.clock[SHORTEST] = min(state.clock[SHORTEST], h)
                state.clock[LONGEST] = max(state.clock[LONGEST], h)
        if last:
            outside = make_step(
                plan.tableau, plan, h, time, window.start, state, constants, motion, measurement
            )
        else:
            outside = make_step(
                plan.tableau, plan, h, time, window.start, state, constants, motion, None
            )
        if every is not None and step == span_end:
            if not last:
                outside += find_far_field(state.far, state, constants)
            kick_by_far_field(state.far, impulse, state, constants)
        state.clock[TIME] = next_time
        state.clock[STEPS] += 1.0
        if outside > 0:
            return outside
        if fraction is not None:
            time = next_time
    return 0


@entry
def advance(
    window: Window,
    pace: Pace,
    plan: Plan,
    state: State,
    constants: Constants,
    motion: Motion,
    measurement: Measurement,
    watch: Watch,
    rows: Array,
) -> tuple[int, int, int]:
    """Advance tick by tick.

    Parameters
    ----------
    rows : float64 (r, len(COLUMNS))
        Filled with the records; the row behind them holds the last tick.

    Returns
    -------
    tuple of int
        Status; ticks made; records written.
    """
    kept = 0
    for tick in range(window.first, window.first + window.ticks):
        outside = _make_tick(
            plan.fraction,
            plan.far_every,
            tick,
            window,
            pace,
            plan,
            state,
            constants,
            motion,
            measurement,
        )
        if outside > 0 or state.piston[0] < watch.floor:
            return OUTSIDE, tick - window.first, kept
        row = rows[kept]
        done = tick + 1
        measure(window.start + state.clock[TIME], state, constants, motion, measurement, row)
        watch.seen[0] = max(watch.seen[0], row[STIFFEST])
        watch.seen[1] = row[STIFFEST]
        watch.seen[2] = max(watch.seen[2], _turned_over(watch, row))
        row[TURNED] = watch.seen[2]
        resting = watch.rest >= 0.0 and _resting(watch, done, row)
        if done % pace.every == 0:
            kept += 1
        if resting:
            return RESTING, done - window.first, kept
        if state.totals[3] >= motion.limit:
            return REACHED, done - window.first, kept
        if _anyone_below(state.y, constants.grains, constants.exit):
            return LEFT, done - window.first, kept
        if row[STIFFEST] * pace.h > watch.stiff:
            return STIFF, done - window.first, kept
    return RUNNING, window.ticks, kept
