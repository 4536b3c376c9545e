"""The loop: kicks and drifts from a table, over ticks that end with a measurement.

A tick is the span between two looks at the bed. At its end the loop takes the energies, the
stiffest mode and the speeds in the pass that the step needs anyway, watches for rest and for
steps that grew too long, and keeps a record every so many ticks.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.effects import drag
from granular.engine.forces import (
    compute_forces,
    kinetic_energy,
    measure_forces,
    potential_energies,
)
from granular.engine.motion import Motion, path
from granular.engine.state import Measurement, State
from granular.engine.stiffness import stiffest_mode
from granular.engine.system import Constants
from granular.pairs.vector import lane_sum

RUNNING, OUTSIDE, RESTING, STIFF = 0, 1, 2, 3

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
    "piston",
    "drag_loss",
    "work",
    "closest",
    "fastest",
    "stiffest",
)
"""One record: time; the piston; the force on each wall; the energies; the ledger; the least
distance of two grains, the greatest speed, and the bound of the highest angular frequency that the
bed can meet."""


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
def _kick_freely(span: float, state: State, count: int, charge: Array | None) -> None:
    if charge is None:
        for i in range(count):
            state.vx[i] += span * state.fx[i]
            state.vy[i] += span * state.fy[i]
    else:
        for i in range(count):
            gain = span / charge[i]
            state.vx[i] += gain * state.fx[i]
            state.vy[i] += gain * state.fy[i]


@compiled
def _kick_with_drag(
    rate: float, span: float, state: State, count: int, charge: Array | None
) -> None:
    decay, gain, a, b, c = drag.flow(rate, span)
    for i in range(count):
        mass = 1.0
        if charge is not None:
            mass = charge[i]
        ax, ay = state.fx[i] / mass, state.fy[i] / mass
        vx, vy = state.vx[i], state.vy[i]
        state.vx[i] = decay * vx + gain * ax
        state.vy[i] = decay * vy + gain * ay
        lost = a * (vx * vx + vy * vy) + b * (vx * ax + vy * ay) + c * (ax * ax + ay * ay)
        state.push[i] = mass * lost
    state.ledger[0] += lane_sum(state.push)


@compiled
def _kick(
    rate: float | None, span: float, state: State, constants: Constants, motion: Motion, time: float
) -> None:
    """Velocities after ``span``, at frozen positions: forces, drag, the piston and its work."""
    if rate is None:
        _kick_freely(span, state, constants.grains, constants.charge)
    else:
        _kick_with_drag(rate, span, state, constants.grains, constants.charge)
    if motion.free:
        state.piston[1] += span * (state.totals[3] - constants.weight) / constants.mass
    else:
        # The work is the conjugate of the path's time, so that it has the method's order.
        state.ledger[1] -= span * state.totals[3] * path(motion, time)[1]


@compiled
def _drift(span: float, state: State, constants: Constants, motion: Motion, time: float) -> None:
    """Positions after ``span``, which ends at ``time`` in the stage."""
    for i in range(constants.grains):
        state.x[i] += span * state.vx[i]
        state.y[i] += span * state.vy[i]
    if motion.free:
        state.piston[0] += span * state.piston[1]
    else:
        height, velocity = path(motion, time)
        if constants.mass < math.inf:
            state.ledger[1] += constants.weight * (height - state.piston[0]) + (
                0.5 * constants.mass * (velocity**2 - state.piston[1] ** 2)
            )
        state.piston[0] = height
        state.piston[1] = velocity


@compiled
def _step(
    h: float,
    time: float,
    kicks: Array,
    drifts: Array,
    state: State,
    constants: Constants,
    motion: Motion,
    measurement: Measurement | None,
) -> int:
    """One step from ``time`` in the stage; the last forces are measured if asked."""
    rate = constants.acting.drag
    outside = 0
    stage = time
    for k in range(drifts.size):
        if kicks[k] != 0.0:
            _kick(rate, kicks[k] * h, state, constants, motion, stage)
        stage += drifts[k] * h
        _drift(drifts[k] * h, state, constants, motion, stage)
        last = k == drifts.size - 1
        if last and measurement is not None:
            outside += measure_forces(state, constants, measurement)
        elif not last or kicks[k + 1] != 0.0:
            outside += compute_forces(state, constants)
    if kicks[drifts.size] != 0.0:
        _kick(rate, kicks[drifts.size] * h, state, constants, motion, stage)
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
    """Fill one record after a measuring pass."""
    kinetic, fastest = kinetic_energy(state, constants)
    pair, wall, weight = potential_energies(state, constants, measurement)
    row[0] = time
    row[1] = state.piston[0]
    row[2] = state.piston[1]
    for side in range(4):
        row[3 + side] = state.totals[side]
    row[7] = kinetic
    row[8] = pair
    row[9] = wall
    row[10] = weight
    row[11] = 0.0
    if constants.mass < math.inf:
        row[11] = 0.5 * constants.mass * state.piston[1] ** 2 + constants.weight * state.piston[0]
    row[12] = state.ledger[0]
    row[13] = state.ledger[1]
    row[14] = measurement.extremes[1] ** -0.2 if measurement.extremes[1] > 0.0 else math.inf
    row[15] = math.sqrt(fastest)
    row[16] = stiffest_mode(row[15], state, constants, motion, measurement)


@compiled
def _resting(watch: Watch, tick: int, row: Array) -> bool:
    """Whether piston and grains have been at rest for the window."""
    height = row[1]
    watch.band[1] = min(watch.band[1], height)
    watch.band[2] = max(watch.band[2], height)
    if watch.band[2] - watch.band[1] > watch.rest or row[15] > watch.rest:
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
                outside = _step(h, time, kicks, drifts, state, constants, motion, measurement)
            else:
                outside = _step(h, time, kicks, drifts, state, constants, motion, None)
            if outside > 0:
                return OUTSIDE, tick - first_tick, kept, step + 1
        row = rows[kept]
        done = tick + 1
        # A short tick at the end of a stage has shorter steps than its length says.
        end = start + min(done * length, begin + steps * h)
        measure(end, state, constants, motion, measurement, row)
        watch.seen[0] = max(watch.seen[0], row[16])
        watch.seen[1] = row[16]
        resting = watch.rest >= 0.0 and _resting(watch, done, row)
        if done % record_every == 0:
            kept += 1
        if resting:
            return RESTING, done - first_tick, kept, 0
        if row[16] * h > watch.stiff:
            return STIFF, done - first_tick, kept, 0
    return RUNNING, ticks, kept, 0
