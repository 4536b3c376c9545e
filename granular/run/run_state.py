"""State of a run: progress in the protocol, steps of the present stage, and criteria that end the stage."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from granular.effects.effect import DissipativeEffect, GrainsAndPistonEffect
from granular.engine import columns
from granular.engine.run_errors import misplaced_grain_error
from granular.engine.state import EnergyLedger, allocate_measurement_scratch_arrays, make_initial_state
from granular.engine.step_size import (
    MAXIMUM_COUNT,
    MAXIMUM_STEPS,
    REVIEW,
    SLACK,
    StepSchedule,
    auto_step_text,
    completed_tick_count,
    highest_impact_frequency_from_python,
    initialise_step_density,
)
from granular.engine.tick_loop import OUTSIDE, STIFFEST, TURNED, StopCriteria, TickRange
from granular.engine.time_step import make_method_tables
from granular.kernel_data.state import (
    HEIGHT,
    LONGEST,
    SHORTEST,
    SPEED,
    STEPS,
    TIME,
    Constants,
    MeasurementScratchArrays,
    State,
)
from granular.protocol import Stage
from granular.protocol.piston_motion import PistonMotion, drive_angular_frequency, maximum_piston_speed
from granular.protocol.stage import TimedStage
from granular.run.dataset import RecordBuffer
from granular.run.engines import (
    ENGINES,
    NO_STOP_CRITERIA,
    NO_TICKS,
    UNDIVIDED,
    TickOutcome,
    TickRequest,
    record_column_count,
)
from granular.run.plan import Plan
from granular.shared.array_types import Float
from granular.shared.errors import NotFiniteError, RunError, StepCountError

ARRANGE = "place the grains apart from each other, inside the walls and below the piston"
"""Remedy in errors about grains at impossible positions."""

REST_TOLERANCE = 1e-4
"""A bed counts as at rest if the piston's range [D] and all speeds [D/tau] are below this default limit."""

DECAY_LIMIT = 10.0
"""Time steps resolve decay rates of drag up to this multiple of the highest angular frequency, or of the
frequency that one step per record resolves, whichever is higher. At higher decay rates grains creep, and the
exact solution for drag is accurate for any step."""

_MAX_RESOLVED_PRODUCT = 0.5
"""Product of step and highest angular frequency below which all oscillations are stable."""


@dataclasses.dataclass
class RunProgress:
    """Progress of a run, which a checkpoint holds in addition to the arrays of the state."""

    stage: int = 0  # index of the present stage
    ticks: int = 0  # ticks made in the stage
    started: bool = False  # True once the stage is set up
    start: float = 0.0  # start of the stage [tau]
    last: float = 0.0  # time of the last record [tau]
    height: float = 0.0  # height of the piston at the start of the stage [m]
    schedule: list[Any] | None = None  # fields of the stage's `StepSchedule`
    stiffest: float = 0.0  # largest step times highest angular frequency so far
    closest: float = math.inf  # minimum distance of two grains so far [D]
    results: list[dict[str, Any]] = dataclasses.field(default_factory=list)  # fields of `StageResult`
    # Grains that have left: index in the scene, time [s], position on removal [m].
    departures: list[list[float]] = dataclasses.field(default_factory=list)


class RunState:
    """State, progress and recorder of a run, with derived quantities."""

    def __init__(self, plan: Plan) -> None:
        scene, system, step = plan.scene, plan.take_system(), plan.step
        self.scene, self.system, self.step = scene, system, step
        self.t_end = math.inf if plan.t_end is None else plan.t_end / system.scales.time
        self.tables = make_method_tables(plan.method, step, system.constants.acting.far)
        self._advance_by_engine = ENGINES.find(plan.engine)
        self.recorder = RecordBuffer(scene.grains.count, system.effects)
        self.progress = RunProgress()
        positions, velocities = scene.initial_positions_and_velocities()
        height = scene.piston.height if scene.piston is not None else 0.0
        scales = system.scales
        start = (positions / scales.length, velocities / scales.velocity, height / scales.length)
        self.state: State = make_initial_state(*start, system.constants.acting, plan.method)
        self.measurement: MeasurementScratchArrays = allocate_measurement_scratch_arrays(self.state)
        self.band, self.seen = np.zeros(3), np.zeros(3)
        self.ledger: EnergyLedger | None = None
        self.motion = PistonMotion()
        self._ledger_columns = columns.energy_ledger_column_count(len(system.effects))
        """Number of columns that are needed for the energy balance."""
        self._row = np.zeros(record_column_count(system))

    @property
    def grain_constants(self) -> Constants:
        """Constants of the grains present in the cell."""
        return self.system.constants

    @grain_constants.setter
    def grain_constants(self, constants: Constants) -> None:
        self.system = dataclasses.replace(self.system, constants=constants)

    @property
    def stage(self) -> Stage:
        """Present stage of the protocol."""
        return self.scene.protocol[self.progress.stage]

    @property
    def stage_duration(self) -> float:
        """Duration of the present stage [tau]; infinite if only ``t_end`` ends it."""
        stage = self.stage
        duration = stage.maximum_duration(self.progress.height)
        last = self.progress.stage == len(self.scene.protocol) - 1
        timed = isinstance(stage, TimedStage) and stage.until is None
        if duration is None or (last and timed and math.isfinite(self.t_end)):
            return math.inf
        return duration / self.system.scales.time

    @property
    def present_time(self) -> float:
        """Present time [tau], at the last whole tick."""
        return self.progress.start + float(self.state.clock[TIME])

    @property
    def step_count(self) -> int:
        """Number of steps made so far."""
        return int(self.state.clock[STEPS])

    @property
    def is_protocol_finished(self) -> bool:
        """True if all stages of the protocol have ended."""
        return self.progress.stage == len(self.scene.protocol)

    @property
    def schedule(self) -> StepSchedule:
        """Division of the present stage into ticks, steps and records; times in [tau]."""
        assert self.progress.schedule is not None
        return StepSchedule(*self.progress.schedule)

    @property
    def is_at_end(self) -> bool:
        """True if at most the partial tick before ``t_end`` remains."""
        progress = self.progress
        if self.is_protocol_finished:
            return True
        if not progress.started:
            return progress.start >= self.t_end * (1.0 - 1e-12) and bool(progress.results)
        before_end = self.whole_tick_count_until(self.stage_duration) > 0 or self.remaining_stage_time() > 0.0
        return before_end and self.whole_tick_count_until_end() <= 0

    def whole_tick_count_until(self, time: float) -> float:
        """Count the whole ticks from now until a time [tau], measured from the start of the stage."""
        return completed_tick_count(self.schedule, time) - self.progress.ticks

    def whole_tick_count_until_end(self) -> float:
        """Count the whole ticks from now until ``t_end``."""
        # A variable step may end after its tick, and a run cannot continue from a step that is cut at
        # ``t_end``. The last two ticks are therefore made separately.
        reserved = 0.0 if self.tables.fraction is None else 2.0
        return self.whole_tick_count_until(self.t_end - self.progress.start) - reserved

    def remaining_stage_time(self, fraction: float = 1e-6) -> float:
        """Return the time [tau] that remains of the stage, or 0 if the remainder is only due to rounding."""
        total = self.stage_duration
        if math.isinf(total):
            return 0.0
        remaining = total - float(self.state.clock[TIME])
        if remaining > self.time_rounding_limit(fraction) or remaining < -1e-6 * self.schedule.length:
            return remaining
        return 0.0

    def time_rounding_limit(self, fraction: float = 1e-6) -> float:
        """Return the maximum difference [tau] between two times that counts as rounding error."""
        return fraction * self.schedule.h if self.progress.ticks else 0.0

    def tick_count_of_next_call(self) -> int:
        """Count the ticks to the next frame, to the next check of the step or to the end of the stage."""
        ticks, schedule = self.progress.ticks, self.schedule
        to_frame = schedule.frames_every - ticks % schedule.frames_every
        to_review = REVIEW - ticks % REVIEW
        to_end = min(self.whole_tick_count_until(self.stage_duration), self.whole_tick_count_until_end())
        return int(min(to_end, to_frame, to_review))

    @property
    def remedy_for_long_steps(self) -> str:
        """Remedy in errors of a run whose steps may be too long."""
        if self.step.is_automatic:
            return f"shorten dt (for instance {auto_step_text(0.25 * self.step.factor)!r})"
        return "shorten dt, or use dt = 'auto'"

    @property
    def remedy_for_non_finite(self) -> str:
        """Remedy in errors of a run with values that are not finite."""
        acting = self.scene.effects.acting
        custom = [
            item.key for item in acting if any(part.user_code_digests for part in item.component_effects)
        ]
        if not custom or self.progress.schedule is None:
            return self.remedy_for_long_steps
        # A shorter step does not help if a formula is NaN. A step that resolves all oscillations is not the
        # cause.
        seen = np.array([self._row[columns.STIFFEST], self.seen[STIFFEST]])
        resolved = (
            np.max(seen, where=np.isfinite(seen), initial=0.0) * self.schedule.h < _MAX_RESOLVED_PRODUCT
        )
        if not resolved:
            return self.remedy_for_long_steps
        return f"correct the formula of {' and '.join(map(repr, custom))}: its value is not a number"

    @property
    def too_long_step_text(self) -> str:
        """Beginning of an error if the user's step is too long for the highest frequency; otherwise empty."""
        if self.step.seconds is None or self.progress.schedule is None:  # no step was made yet
            return ""
        periods = max(self._row[columns.STIFFEST], self.seen[STIFFEST]) * self.schedule.h / math.tau
        if not periods * math.tau > 1.0:
            return ""
        return f"dt = {self.step.seconds:g} s is {periods:.2g} periods of the stiffest mode: "

    def present_record(self, remedy: str) -> Float[np.ndarray, "columns"]:
        """Compute the present forces and return a record; errors for misplaced grains contain ``remedy``."""
        # A loop without ticks avoids the compilation of another kernel.
        window = NO_TICKS._replace(start=self.progress.start)
        status, _, records = self.call_engine(window, UNDIVIDED, NO_STOP_CRITERIA)
        self._row = records[0]
        self._row[columns.TURNED] = self.seen[TURNED]
        if status == OUTSIDE:
            raise self.misplaced_grain_error(remedy)
        return self._row

    def call_engine(self, window: TickRange, schedule: StepSchedule, watch: StopCriteria) -> TickOutcome:
        """Call the engine to advance the state by ticks."""
        ticks = TickRequest(window, schedule, self.tables, self.motion, self.measurement, watch)
        return self._advance_by_engine(self.system, self.state, ticks)

    def total_energy(self, remedy: str) -> float:
        """Return the present energy of grains and piston [F* D]."""
        return columns.total_energy(self.present_record(remedy)[: self._ledger_columns])

    def misplaced_grain_error(self, remedy: str) -> RunError:
        """Make the error for a misplaced grain, with the present step and time."""
        moment = self.step_count, self.present_time * self.system.scales.time
        lines, scales = self.scene.cell.lines, self.system.scales
        error = misplaced_grain_error(self.state, self.grain_constants, lines, scales, *moment, remedy)
        if isinstance(error, NotFiniteError) and remedy == self.remedy_for_long_steps:
            return error.with_context(self.too_long_step_text, self.remedy_for_non_finite)
        return error.with_context(self.too_long_step_text)

    # The step schedule ---------------------------------------------------------------------------

    def set_step_schedule(self, row: Float[np.ndarray, "columns"]) -> None:
        """Divide the stage into ticks and steps, with frequencies estimated from its first record ``row``."""
        output, scales, gravity = self.scene.output, self.system.scales, self.system.downward_acceleration
        # A grain may still gain speed from its height.
        top = float(self.state.y[: self.grain_constants.grains].max(initial=0.0))
        speed = math.sqrt(row[columns.FASTEST] ** 2 + 2.0 * gravity * top)
        height, falling = self.state.piston[HEIGHT], self.state.piston[SPEED]
        speed += maximum_piston_speed(self.motion, self.grain_constants.piston_mass, gravity, height, falling)
        speed += sum(
            effect.maximum_imparted_speed(scales)
            for effect in self.system.effects
            if isinstance(effect, GrainsAndPistonEffect)
        )
        frequency = max(
            float(row[columns.STIFFEST]), highest_impact_frequency_from_python(self.grain_constants, speed)
        )
        record, frame = output.scalars / scales.time, output.frames / scales.time
        frequency = self._frequency_to_resolve(frequency)
        schedule = self.step.divide_stage_into_steps(record, frame, frequency, scales.time)
        self._store_schedule(schedule)
        end = min(self.stage_duration, self.t_end - self.progress.start)
        steps = end / schedule.h if end < math.inf else 0.0
        self._refuse_too_many_steps("the time to the end", steps, MAXIMUM_COUNT)
        if self.tables.fraction is not None:
            half_tick = 0.5 * schedule.length
            initialise_step_density(speed, half_tick, self.tables.fraction, self.state, self.grain_constants)

    def set_steps_per_tick(self, frequency: float) -> None:
        """Divide ticks into steps that resolve a frequency [1/tau]; variable steps need no division."""
        if self.tables.fraction is None:
            length = self.schedule.length
            steps = self.step.step_count_per_tick(length, self._frequency_to_resolve(frequency))
            self._store_schedule(self.schedule._replace(steps=steps, h=length / steps))

    def _frequency_to_resolve(self, frequency: float) -> float:
        """Return the angular frequency that an automatic step must resolve, including drive and drag."""
        scales, effects = self.system.scales, self.system.effects
        rates = [effect.decay_rate(scales) for effect in effects if isinstance(effect, DissipativeEffect)]
        record = self.scene.output.scalars / scales.time
        slowest = max(frequency, self.step.step_times_frequency / record)
        drives = [effect.drive_angular_frequency(scales) for effect in effects]
        decay = min(max(rates, default=0.0), DECAY_LIMIT * slowest)
        resolved = max(frequency, drive_angular_frequency(self.motion), *drives, decay)
        if self.step.is_automatic:
            steps = record * resolved / self.step.step_times_frequency
            self._refuse_too_many_steps("the time between records", steps, MAXIMUM_STEPS)
        return resolved

    def _refuse_too_many_steps(self, duration_name: str, steps: float, limit: float) -> None:
        if not steps <= limit:
            raise StepCountError(
                f"{duration_name} requires {steps:.3g} steps; the limit is {limit:.3g}",
                step=self.step_count,
                time=self.present_time * self.system.scales.time,
                value=steps,
                remedy="check the units of the scene and of t_end, or shorten output.scalars",
            )

    def _store_schedule(self, schedule: StepSchedule) -> None:
        self.progress.schedule = list(schedule)
        if self.tables.fraction is None:
            clock = self.state.clock
            clock[SHORTEST] = min(clock[SHORTEST], schedule.h)
            clock[LONGEST] = max(clock[LONGEST], schedule.h)

    # The end of a stage --------------------------------------------------------------------------

    @property
    def rest_tolerance(self) -> float:
        """Limit of range [D] and speeds [D/tau] at rest; negative if the stage does not end at rest."""
        stage = self.stage
        if not isinstance(stage, TimedStage) or stage.until != "rest":
            return -1.0
        if stage.tolerance is None:
            return REST_TOLERANCE
        return stage.tolerance / self.system.scales.length

    def stop_criteria(self) -> StopCriteria:
        """Criteria at which the compiled loop stops during the present stage, in natural units."""
        stage, rest, window = self.stage, self.rest_tolerance, 0
        if isinstance(stage, TimedStage) and rest >= 0.0:
            ticks = stage.window / self.system.scales.time / self.schedule.length
            window = math.ceil(min(ticks, MAXIMUM_COUNT))
        shortened = self.step.is_automatic and self.tables.fraction is None
        stiff = SLACK * self.step.step_times_frequency if shortened else math.inf
        assert self.ledger is not None
        potential, piston = self.ledger.potential, self.ledger.piston
        floor = -math.inf if self.scene.piston is None else 0.0
        return StopCriteria(stiff, rest, window, self.band, self.seen, potential, piston, floor)
