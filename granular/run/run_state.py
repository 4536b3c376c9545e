"""The state of a run in its protocol and in time: how a stage is stepped, and when it ends at rest."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from granular.effects.effect import DissipativeEffect, MovingFrameEffect
from granular.engine import columns
from granular.engine.run_errors import misplaced_grain_error
from granular.engine.state import EnergyLedger, new_measurement, new_state
from granular.engine.step_size import (
    MOST_COUNT,
    MOST_STEPS,
    REVIEW,
    SLACK,
    StepSchedule,
    auto_step_text,
    completed_ticks,
    evaluate_highest_impact_frequency,
    initialise_step_density,
)
from granular.engine.tick_loop import OUTSIDE, STIFFEST, TURNED, StopCriteria, TickRange
from granular.engine.time_step import make_step_plan
from granular.kernel_data.state import (
    HEIGHT,
    LONGEST,
    SHORTEST,
    SPEED,
    STEPS,
    TIME,
    Constants,
    Measurement,
    State,
)
from granular.protocol import Stage
from granular.protocol.piston_motion import Motion, drive_angular_frequency, greatest_piston_speed
from granular.protocol.stage import TimedStage
from granular.run.dataset import RecordBuffer
from granular.run.engines import ENGINES, NO_TICKS, UNDIVIDED, UNWATCHED, Rows, Ticks, record_length
from granular.run.plan import Plan
from granular.shared.array_types import Float
from granular.shared.errors import NotFiniteError, RunError, StepCountError

ARRANGE = "place the grains apart from each other, inside the walls and below the piston"
"""The remedy for grains that stand where none can be."""

REST_TOLERANCE = 1e-4
"""Rest where the stage gives no tolerance [D], [D/tau]."""

DECAY_LIMIT = 10.0
"""A decay by drag is resolved as far as it is at most this much faster than the stiffest mode (or
than one that a step from record to record would resolve): a faster one leaves grains that creep,
which the exact flow of drag carries at any step."""

_RESOLVED = 0.5
"""Step times highest angular frequency, below which no swing blows up."""


@dataclasses.dataclass
class RunProgress:
    """Progress of a run: what a checkpoint needs besides the arrays of the state."""

    stage: int = 0  # index of the present stage
    ticks: int = 0  # made in it
    started: bool = False  # it has been set up
    start: float = 0.0  # of the stage [tau]
    last: float = 0.0  # time of the last record [tau]
    height: float = 0.0  # of the piston at the stage's start [m]
    schedule: list[Any] | None = None  # fields of its `StepSchedule`
    stiffest: float = 0.0  # largest step times highest angular frequency so far
    closest: float = math.inf  # least distance of two grains so far [D]
    results: list[dict[str, Any]] = dataclasses.field(default_factory=list)  # of `StageResult`
    # Grains that have left: index in the scene, time [s], place when taken out [m].
    departures: list[list[float]] = dataclasses.field(default_factory=list)


class RunState:
    """State, progress and recorder of a run, and all that follows from them."""

    def __init__(self, plan: Plan) -> None:
        scene, system, step = plan.scene, plan.take_system(), plan.step
        self.scene, self.system, self.step = scene, system, step
        self.t_end = math.inf if plan.t_end is None else plan.t_end / system.scales.time
        self.tables = make_step_plan(plan.method, step, system.constants.acting.far)
        self._advance_by_engine = ENGINES.find(plan.engine)
        self.recorder = RecordBuffer(scene.grains.count, system.effects)
        self.progress = RunProgress()
        positions, velocities = scene.initial_positions_and_velocities()
        height = scene.piston.height if scene.piston is not None else 0.0
        scales = system.scales
        start = (positions / scales.length, velocities / scales.velocity, height / scales.length)
        self.state: State = new_state(*start, system.constants.acting, plan.method)
        self.measurement: Measurement = new_measurement(self.state)
        self.band, self.seen = np.zeros(3), np.zeros(3)
        self.ledger: EnergyLedger | None = None
        self.motion = Motion()
        self._entered = columns.ledger_column_count(len(system.effects))
        """Columns that the energy ledger reads."""
        self._row = np.zeros(record_length(system))

    @property
    def constants(self) -> Constants:
        """Constants of the grains that are there."""
        return self.system.constants

    @constants.setter
    def constants(self, constants: Constants) -> None:
        self.system = dataclasses.replace(self.system, constants=constants)

    @property
    def stage(self) -> Stage:
        """Present stage of the protocol."""
        return self.scene.protocol[self.progress.stage]

    @property
    def stage_length(self) -> float:
        """Length of the present stage [tau]; infinite where only ``t_end`` ends it."""
        stage = self.stage
        duration = stage.total_duration(self.progress.height)
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
    def steps_made(self) -> int:
        """Number of steps made so far."""
        return int(self.state.clock[STEPS])

    @property
    def is_protocol_finished(self) -> bool:
        """True where all stages of the protocol have ended."""
        return self.progress.stage == len(self.scene.protocol)

    @property
    def schedule(self) -> StepSchedule:
        """Ticks, steps and records of the present stage [tau]."""
        assert self.progress.schedule is not None
        return StepSchedule(*self.progress.schedule)

    @property
    def is_at_end(self) -> bool:
        """True where nothing but the unfinished tick before ``t_end`` is left."""
        progress = self.progress
        if self.is_protocol_finished:
            return True
        if not progress.started:
            return progress.start >= self.t_end * (1.0 - 1e-12) and bool(progress.results)
        before_end = self.whole_ticks_until(self.stage_length) > 0 or self.remaining_stage_time() > 0.0
        return before_end and self.whole_ticks_until_end() <= 0

    def whole_ticks_until(self, time: float) -> float:
        """Count the whole ticks from here to a time in the stage; time [tau]."""
        return completed_ticks(self.schedule, time) - self.progress.ticks

    def whole_ticks_until_end(self) -> float:
        """Whole ticks that are left to ``t_end``."""
        # A variable step may end behind its tick, and one that is cut at ``t_end`` is no state to go on from:
        # the tail has the last two ticks.
        spared = 0.0 if self.tables.fraction is None else 2.0
        return self.whole_ticks_until(self.t_end - self.progress.start) - spared

    def remaining_stage_time(self, least: float = 1e-6) -> float:
        """Time left of the stage behind its last whole tick [tau]."""
        total = self.stage_length
        if math.isinf(total):
            return 0.0
        left = total - float(self.state.clock[TIME])
        if left > self.rounding_time(least) or left < -1e-6 * self.schedule.length:
            return left
        return 0.0

    def rounding_time(self, fraction: float = 1e-6) -> float:
        """Time below which rounding leaves something to an end that was reached [tau]."""
        return fraction * self.schedule.h if self.progress.ticks else 0.0

    def ticks_of_next_call(self) -> int:
        """Count the ticks that may be made at once: up to the end, the next frame or the next review."""
        ticks, schedule = self.progress.ticks, self.schedule
        to_frame = schedule.frames_every - ticks % schedule.frames_every
        to_review = REVIEW - ticks % REVIEW
        to_end = min(self.whole_ticks_until(self.stage_length), self.whole_ticks_until_end())
        return int(min(to_end, to_frame, to_review))

    @property
    def remedy_for_long_steps(self) -> str:
        """Advice in words against steps that are too long."""
        if self.step.automatic:
            return f"shorten dt (for instance {auto_step_text(0.25 * self.step.factor)!r})"
        return "shorten dt (or leave it 'auto')"

    @property
    def remedy_for_non_finite(self) -> str:
        """Advice in words against numbers that are not finite any more."""
        acting = self.scene.effects.acting
        own = [item.key for item in acting if any(part.user_code_digests for part in item.component_effects)]
        if not own or self.progress.schedule is None:
            return self.remedy_for_long_steps
        # No step cures a formula that is NaN somewhere, and one that resolves all oscillations has not led
        # the grains astray.
        seen = np.array([self._row[columns.STIFFEST], self.seen[STIFFEST]])
        resolved = np.max(seen, where=np.isfinite(seen), initial=0.0) * self.schedule.h < _RESOLVED
        if not resolved:
            return self.remedy_for_long_steps
        return f"correct what you wrote for {' and '.join(map(repr, own))}: it is no number there"

    @property
    def too_long_step_text(self) -> str:
        """Words that blame a given step for being too long for the stiffest mode; empty where it is not."""
        if self.step.seconds is None or self.progress.schedule is None:  # no step was made yet
            return ""
        swings = max(self._row[columns.STIFFEST], self.seen[STIFFEST]) * self.schedule.h / math.tau
        if not swings * math.tau > 1.0:
            return ""
        return f"dt = {self.step.seconds:g} s is {swings:.2g} periods of the stiffest swing: "

    def present_record(self, remedy: str) -> Float[np.ndarray, "columns"]:
        """Compute the forces, and a record of the present moment."""
        # A loop without ticks: no kernel more to compile.
        window = NO_TICKS._replace(start=self.progress.start)
        status, _, records = self.call_engine(window, UNDIVIDED, UNWATCHED)
        self._row = records[0]
        self._row[columns.TURNED] = self.seen[TURNED]
        if status == OUTSIDE:
            raise self.misplaced_grain_error(remedy)
        return self._row

    def call_engine(self, window: TickRange, schedule: StepSchedule, watch: StopCriteria) -> Rows:
        """Have the engine advance the state by ticks."""
        ticks = Ticks(window, schedule, self.tables, self.motion, self.measurement, watch)
        return self._advance_by_engine(self.system, self.state, ticks)

    def total_energy(self, remedy: str) -> float:
        """Total energy of the present moment, in the ledger's sense [F* D]."""
        return columns.total_energy(self.present_record(remedy)[: self._entered])

    def misplaced_grain_error(self, remedy: str) -> RunError:
        """Error for a grain that stands where none can be, with the present step and time."""
        moment = self.steps_made, self.present_time * self.system.scales.time
        lines, scales = self.scene.cell.lines, self.system.scales
        error = misplaced_grain_error(self.state, self.constants, lines, scales, *moment, remedy)
        if isinstance(error, NotFiniteError) and remedy == self.remedy_for_long_steps:
            return error.with_context(self.too_long_step_text, self.remedy_for_non_finite)
        return error.with_context(self.too_long_step_text)

    # The step schedule ---------------------------------------------------------------------------

    def set_step_schedule(self, row: Float[np.ndarray, "columns"]) -> None:
        """Cut the stage into ticks and steps, by the speeds that the bed can reach from its first record."""
        output, scales, gravity = self.scene.output, self.system.scales, self.system.downward_acceleration
        # A grain may still gain what it loses in height.
        top = float(self.state.y[: self.constants.grains].max(initial=0.0))
        speed = math.sqrt(row[columns.FASTEST] ** 2 + 2.0 * gravity * top)
        height, falling = self.state.piston[HEIGHT], self.state.piston[SPEED]
        speed += greatest_piston_speed(self.motion, self.constants.piston_mass, gravity, height, falling)
        speed += sum(
            effect.maximum_imparted_speed(scales)
            for effect in self.system.effects
            if isinstance(effect, MovingFrameEffect)
        )
        frequency = max(
            float(row[columns.STIFFEST]), evaluate_highest_impact_frequency(self.constants, speed)
        )
        record, frame = output.scalars / scales.time, output.frames / scales.time
        frequency = self._frequency_to_resolve(frequency)
        schedule = self.step.divide_stage(record, frame, frequency, scales.time)
        self._apply_schedule(schedule)
        end = min(self.stage_length, self.t_end - self.progress.start)
        steps = end / schedule.h if end < math.inf else 0.0
        self._refuse_too_many_steps("the path to the end", steps, MOST_COUNT)
        if self.tables.fraction is not None:
            half_tick = 0.5 * schedule.length
            initialise_step_density(speed, half_tick, self.tables.fraction, self.state, self.constants)

    def set_steps_per_tick(self, frequency: float) -> None:
        """Cut the ticks into steps for another frequency [1/tau]; a variable step does so itself."""
        if self.tables.fraction is None:
            length = self.schedule.length
            steps = self.step.steps_per_tick(length, self._frequency_to_resolve(frequency))
            self._apply_schedule(self.schedule._replace(steps=steps, h=length / steps))

    def _frequency_to_resolve(self, frequency: float) -> float:
        """Frequency that an automatic step is to resolve, with the drive and the drag."""
        scales, effects = self.system.scales, self.system.effects
        rates = [effect.decay_rate(scales) for effect in effects if isinstance(effect, DissipativeEffect)]
        record = self.scene.output.scalars / scales.time
        slowest = max(frequency, self.step.step_times_frequency / record)
        drives = [effect.drive_angular_frequency(scales) for effect in effects]
        decay = min(max(rates, default=0.0), DECAY_LIMIT * slowest)
        resolved = max(frequency, drive_angular_frequency(self.motion), *drives, decay)
        if self.step.automatic:
            steps = record * resolved / self.step.step_times_frequency
            self._refuse_too_many_steps("the time from record to record", steps, MOST_STEPS)
        return resolved

    def _refuse_too_many_steps(self, what: str, steps: float, limit: float) -> None:
        if not steps <= limit:
            raise StepCountError(
                f"{what} takes {steps:.3g} steps, {limit:.3g} is the limit",
                step=self.steps_made,
                time=self.present_time * self.system.scales.time,
                value=steps,
                remedy="check the units of the scene and of t_end, or shorten output.scalars",
            )

    def _apply_schedule(self, schedule: StepSchedule) -> None:
        self.progress.schedule = list(schedule)
        if self.tables.fraction is None:
            clock = self.state.clock
            clock[SHORTEST] = min(clock[SHORTEST], schedule.h)
            clock[LONGEST] = max(clock[LONGEST], schedule.h)

    # The end of a stage --------------------------------------------------------------------------

    @property
    def rest_motion_limit(self) -> float:
        """Range of heights [D] and speed [D/tau] that count as rest; negative for other ends."""
        stage = self.stage
        if not isinstance(stage, TimedStage) or stage.until != "rest":
            return -1.0
        if stage.tolerance is None:
            return REST_TOLERANCE
        return stage.tolerance / self.system.scales.length

    def stop_criteria(self) -> StopCriteria:
        """Criteria at which the compiled loop stops in the present stage, in natural units."""
        stage, rest, window = self.stage, self.rest_motion_limit, 0
        if isinstance(stage, TimedStage) and rest >= 0.0:
            ticks = stage.window / self.system.scales.time / self.schedule.length
            window = math.ceil(min(ticks, MOST_COUNT))
        shortened = self.step.automatic and self.tables.fraction is None
        stiff = SLACK * self.step.step_times_frequency if shortened else math.inf
        assert self.ledger is not None
        potential, piston = self.ledger.potential, self.ledger.piston
        floor = -math.inf if self.scene.piston is None else 0.0
        return StopCriteria(stiff, rest, window, self.band, self.seen, potential, piston, floor)
