"""Time loop of a stage, which is divided into ticks.

A tick consists of several steps and a measurement. Energies, highest frequency and speeds are measured in the
force evaluation that the last step needs anyway. The loop then checks whether the bed is at rest, the target
force is reached, a grain has left or the step has become too long. It stores a record at regular intervals
of ticks.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled, entry
from granular.compiled.hook_calls import by_reference
from granular.effects.wall_discs import DiscWall
from granular.effects.wall_laws import upward_force_of_grains_on_body
from granular.engine import columns
from granular.engine.bodies import fill_body_records, piston_energy
from granular.engine.forces import (
    compute_and_measure_forces,
    compute_far_field,
    kick_by_far_field_change,
    kinetic_energy_and_maximum_squared_speed,
    pair_energy_and_fill_law_energies,
)
from granular.engine.step_size import (
    StepSchedule,
    advance_step_density_and_return_step,
    highest_frequency_bound,
    step_count_of_tick,
    tick_start_time,
)
from granular.engine.time_step import MethodTables, advance_one_step
from granular.kernel_data.state import (
    HEIGHT,
    LONGEST,
    LOSSES,
    PISTON,
    PISTON_LOSS,
    SHORTEST,
    SPEED,
    STEPS,
    TIME,
    WORK,
    Bed,
    Constants,
    MeasurementScratchArrays,
    State,
)
from granular.pairs.direct_sum import PADDING
from granular.protocol.piston_motion import PistonMotion
from granular.shared.array_types import Float

RUNNING, OUTSIDE, RESTING, STIFF, REACHED, REMOVED = range(6)
"""Reasons for the loop to return, in the order of the names:

- all ticks are done;
- a grain is at an impossible position;
- piston and grains are at rest;
- the step has become too long;
- the target force is reached;
- a grain has left through a gap.
"""

STARTED, LOWEST, HIGHEST = range(3)
"""Indices in `StopCriteria.band`."""

STIFFEST, LATEST, TURNED = range(3)
"""Indices in `StopCriteria.seen`."""


class StopCriteria(NamedTuple):
    """Conditions that end the loop, and the values, updated at every tick, that are needed to check them."""

    stiff: float  # upper limit of step times highest angular frequency
    rest: float  # maximum range of heights [D] and maximum speed [D/tau] at rest; negative: not checked
    window: int  # number of ticks for which the bed must be at rest
    band: Float[np.ndarray, "3"]  # first tick of the current range of heights; its bounds [D]
    seen: Float[np.ndarray, "3"]  # highest and latest frequency [1/tau]; maximum energy turned over [F* D]
    potential: float  # potential energy at the run's start [F* D]
    piston: float  # piston energy at the run's start [F* D]
    floor: float  # minimum height of the piston [D]


@compiled
def fill_record_row(
    time: float,
    bed: Bed,
    motion: PistonMotion,
    measurement: MeasurementScratchArrays,
    row: Float[Array, "columns"],
) -> None:
    """Fill one record after a measuring pass."""
    state, constants = bed.state, bed.constants
    kinetic, fastest = kinetic_energy_and_maximum_squared_speed(bed)
    laws = state.ledger.size - LOSSES
    energies = row[columns.ENERGIES : columns.ENERGIES + laws]
    pair = pair_energy_and_fill_law_energies(bed, time, measurement, energies)
    row[columns.TIME] = time
    row[columns.HEIGHT] = state.piston[HEIGHT]
    row[columns.VELOCITY] = state.piston[SPEED]
    row[columns.UPWARD] = upward_force_of_grains_on_body(bed, PISTON)
    row[columns.KINETIC] = kinetic
    row[columns.PAIR] = pair
    row[columns.PISTON] = piston_energy(bed, time)
    row[columns.WORK] = state.ledger[WORK]
    row[columns.PISTON_LOSS] = state.ledger[PISTON_LOSS]
    for law in range(laws):
        row[columns.ENERGIES + laws + law] = state.ledger[LOSSES + law]
    fifth = measurement.energy_and_closest[1]  # power of the inverse distance
    row[columns.CLOSEST] = fifth**-0.2 if fifth > 0.0 else math.inf
    row[columns.FASTEST] = math.sqrt(fastest)
    row[columns.STIFFEST] = highest_frequency_bound(row[columns.FASTEST], bed, motion, measurement)
    row[columns.GRAINS] = constants.grains
    sides, last = state.wall_forces.size, row.size
    for side in range(sides):
        row[last - sides + side] = state.wall_forces[side]
    own = row[columns.ENERGIES + 2 * laws : last - sides]
    fill_body_records(constants.acting.host, state, time, own)


@compiled
def _is_any_grain_below_height(y: Array, count: int, height: float) -> bool:
    for i in range(count):  # noqa: SIM110 (a loop is what compiles)
        if y[i] < height:
            return True
    return False


@compiled
def _has_come_to_rest(criteria: StopCriteria, tick: int, row: Array) -> bool:
    """Return True if piston and grains have been at rest for ``criteria.window`` ticks."""
    height = row[columns.HEIGHT]
    criteria.band[LOWEST] = min(criteria.band[LOWEST], height)
    criteria.band[HIGHEST] = max(criteria.band[HIGHEST], height)
    if criteria.band[HIGHEST] - criteria.band[LOWEST] > criteria.rest or row[columns.FASTEST] > criteria.rest:
        criteria.band[STARTED] = tick
        criteria.band[LOWEST] = height
        criteria.band[HIGHEST] = height
    return tick - criteria.band[STARTED] >= criteria.window


class TickRange(NamedTuple):
    """Range of ticks to advance."""

    start: float  # time at the start of the stage [tau]
    origin: float  # time from the start of the stage to tick 0 [tau]
    limit: float  # time in the stage at which variable steps end [tau]
    first: int  # index of the first tick
    ticks: int  # number of ticks


@compiled
def _energy_turnover(criteria: StopCriteria, laws: int, row: Array) -> float:
    """Return the energy turned over since the start; see `granular.engine`."""
    c = columns
    potential, lost = row[c.PAIR] - criteria.potential, row[c.PISTON_LOSS]
    for law in range(laws):
        potential += row[c.ENERGIES + law]
        lost += abs(row[c.ENERGIES + laws + law])  # a bath can return energy
    piston = abs(row[c.PISTON] - criteria.piston)
    return row[c.KINETIC] + abs(potential) + piston + lost + abs(row[c.WORK])


@compiled
def _advance_one_tick(
    fraction: float | None,
    every: int | None,
    tick: int,
    window: TickRange,
    schedule: StepSchedule,
    plan: MethodTables,
    bed: Bed,
    motion: PistonMotion,
    measurement: MeasurementScratchArrays,
) -> int:
    """Make the steps of a tick; return the number of grains at impossible positions."""
    state = bed.state
    begin, end = (
        window.origin + tick_start_time(schedule, tick),
        window.origin + tick_start_time(schedule, tick + 1),
    )
    steps, step, time, h, last = step_count_of_tick(schedule, tick), 0, begin, schedule.h, False
    duration, durations, span_end, outside = 0, 1, 0, 0
    if every is not None:
        durations = (steps + every - 1) // every
    if fraction is not None:
        time = state.clock[TIME]
        end = min(end, window.limit)
        if time >= end:
            return compute_and_measure_forces(bed, window.start + time, measurement)
    while not last:
        if every is not None and step == span_end:
            duration += 1
            span_end = duration * steps // durations
            # Half of the impulse before and half after the interval (Tuckerman, Berne and Martyna 1992,
            # doi:10.1063/1.463137).
            impulse = 0.5 * (span_end - step) * h
            kick_by_far_field_change(state.far_forces, impulse, bed)
        if fraction is None:
            time = begin + step * h
            step += 1
            last = step == steps
            next_time = end if last else time + h
        else:
            h = advance_step_density_and_return_step(fraction, bed)
            next_time = time + h
            last = next_time >= end
            # Only the last step of a stage is shortened; it does not count as the shortest step.
            if next_time >= window.limit:
                h, next_time = window.limit - time, window.limit
            else:
                state.clock[SHORTEST] = min(state.clock[SHORTEST], h)
                state.clock[LONGEST] = max(state.clock[LONGEST], h)
        outside = advance_one_step(plan.tableau, plan, h, time, window.start, bed, motion, measurement, last)
        if every is not None and step == span_end:
            if not last:
                outside += compute_far_field(state.far_forces, bed, next_time)
            kick_by_far_field_change(state.far_forces, impulse, bed)
        state.clock[TIME] = next_time
        state.clock[STEPS] += 1.0
        if outside > 0:
            return outside
        if fraction is not None:
            time = next_time
    return 0


@entry
def advance_ticks(
    window: TickRange,
    schedule: StepSchedule,
    plan: MethodTables,
    state: State,
    constants: Constants,
    motion: PistonMotion,
    measurement: MeasurementScratchArrays,
    criteria: StopCriteria,
    rows: Float[Array, "r columns"],
) -> tuple[int, int, int]:
    """Advance by a range of ticks; return the reason to end, and the numbers of ticks and records."""
    return _advance_window(
        by_reference(window),
        by_reference(schedule),
        by_reference(plan),
        by_reference(Bed(state, constants)),
        by_reference(motion),
        by_reference(measurement),
        by_reference(criteria),
        rows,
    )


@compiled
def _record_without_advancing(
    window: TickRange, bed: Bed, motion: PistonMotion, measurement: MeasurementScratchArrays, row: Array
) -> int:
    state = bed.state
    time = window.start + state.clock[TIME]
    outside = compute_and_measure_forces(bed, time, measurement)
    fill_record_row(time, bed, motion, measurement, row)
    return OUTSIDE if outside > 0 else RUNNING


@compiled
def _advance_window(
    window: TickRange,
    schedule: StepSchedule,
    plan: MethodTables,
    bed: Bed,
    motion: PistonMotion,
    measurement: MeasurementScratchArrays,
    criteria: StopCriteria,
    rows: Array,
) -> tuple[int, int, int]:
    state, constants = bed.state, bed.constants
    if window.ticks == 0:
        return _record_without_advancing(window, bed, motion, measurement, rows[0]), 0, 0
    saved, laws = 0, state.ledger.size - LOSSES
    for tick in range(window.first, window.first + window.ticks):
        outside = _advance_one_tick(
            plan.fraction, plan.far_every, tick, window, schedule, plan, bed, motion, measurement
        )
        if outside > 0 or state.piston[HEIGHT] < criteria.floor:
            return OUTSIDE, tick - window.first, saved
        row = rows[saved]
        done = tick + 1
        fill_record_row(window.start + state.clock[TIME], bed, motion, measurement, row)
        criteria.seen[STIFFEST] = max(criteria.seen[STIFFEST], row[columns.STIFFEST])
        criteria.seen[LATEST] = row[columns.STIFFEST]
        turned = _energy_turnover(criteria, laws, row)
        criteria.seen[TURNED] = max(criteria.seen[TURNED], turned)
        row[columns.TURNED] = criteria.seen[TURNED]
        resting = criteria.rest >= 0.0 and _has_come_to_rest(criteria, done, row)
        if done % schedule.every == 0:
            saved += 1
        if resting:
            return RESTING, done - window.first, saved
        if upward_force_of_grains_on_body(bed, PISTON) >= motion.limit:
            return REACHED, done - window.first, saved
        if _is_any_grain_below_height(state.y, constants.grains, constants.exit):
            return REMOVED, done - window.first, saved
        if row[columns.STIFFEST] * schedule.h > criteria.stiff:
            return STIFF, done - window.first, saved
    return RUNNING, window.ticks, saved


def constant_arrays_per_grain(constants: Constants) -> list[np.ndarray]:
    """Return the constants that are arrays with one value per grain, which are reordered with the grains."""
    acting = constants.acting
    result = [constants.masses, constants.moments, acting.weight, acting.charges, acting.shift]
    if acting.near is not None:
        result.append(acting.near.species)
    result += [side.law.species for side in acting.sides if isinstance(side.law, DiscWall)]
    # All arrays of a law have one value per grain; any other array is in a nested tuple of the law.
    result += [values for law in acting.laws for values in law]
    # Masses, moments and charges may be one array, and must not be moved twice.
    return list({id(values): values for values in result if isinstance(values, np.ndarray)}.values())


def remove_outflowed_grains(state: State, constants: Constants) -> Constants:
    """Remove the grains below the exit; move the last grains of the arrays into the free entries."""
    grains = constants.grains
    for i in range(grains - 1, -1, -1):
        if state.y[i] < constants.exit:
            grains -= 1
            _replace_by_last_grain(i, grains, state, constants)
    state.scratch[:] = 0.0
    for workspace in state.workspaces:
        if isinstance(workspace, np.ndarray):
            workspace[:] = 0.0
    return constants._replace(grains=grains)


def _replace_by_last_grain(i: int, last: int, state: State, constants: Constants) -> None:
    """Swap a grain with the last one, and fill the last entry with padding."""
    moving = [state.x, state.y, state.vx, state.vy, state.label, *constant_arrays_per_grain(constants)]
    if state.rounding is not None:
        moving += list(state.rounding)
    for values in moving:
        values[[i, last]] = values[[last, i]]
    state.x[last], state.y[last] = PADDING * (last + 1.0), 0.0
    state.vx[last] = state.vy[last] = 0.0
    if state.rounding is not None:
        state.rounding[:, last] = 0.0
