"""Execution of a protocol, stage by stage, from the start or from the last checkpoint."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from granular.engine import columns
from granular.engine.forces import hold_present_far_field
from granular.engine.run_errors import not_at_rest_error
from granular.engine.state import EnergyLedger
from granular.engine.step_size import REVIEW, StepSchedule
from granular.engine.tick_loop import (
    HIGHEST,
    LATEST,
    LOWEST,
    OUTSIDE,
    REACHED,
    REMOVED,
    RESTING,
    STIFF,
    STIFFEST,
    StopCriteria,
    TickRange,
    remove_outflowed_grains,
)
from granular.kernel_data.state import HEIGHT, LONGEST, SHORTEST, SPEED, TIME, WORK
from granular.protocol.piston_motion import driven_height_and_velocity
from granular.protocol.stage import TimedStage
from granular.protocol.stages import name_stage_in_errors
from granular.run.engines import TickOutcome
from granular.run.plan import Plan, ThreadCountTuner
from granular.run.run_state import ARRANGE, RunState
from granular.scene.scene import has_depaula_friction_or_pair_list
from granular.schema.cell import CELL, PISTON
from granular.shared.errors import EnergyError, NotFiniteError, RunError

CALL_SECONDS = 0.1
"""Duration [s] of one call of the compiled loop. Ctrl-C takes effect within this time."""


class ProtocolRunner(RunState):
    """State of a run, with methods that advance it by successive calls of the compiled loop."""

    _call_ticks = 1

    def __init__(self, plan: Plan) -> None:
        super().__init__(plan)
        self.threads = ThreadCountTuner(plan.threads if plan.tries_threads else 1)

    def summary_values(self) -> dict[str, Any]:
        """Return step count, energy residual, shortest and longest step, and closest distance, in SI."""
        scales, progress, clock = self.system.scales, self.progress, self.state.clock
        figures: dict[str, Any] = {
            "steps": self.step_count,
            "ledger_residual": 0.0 if self.ledger is None else self.ledger.worst_relative_residual,
        }
        if self.step_count:
            figures["shortest_step"] = float(clock[SHORTEST]) * scales.time
            figures["longest_step"] = float(clock[LONGEST]) * scales.time
        if self.tables.fraction is None:
            figures["step_times_highest_frequency"] = progress.stiffest
        if math.isfinite(progress.closest):
            figures["closest_distance"] = progress.closest * scales.length
        return figures

    def begin_stage(self) -> None:
        """Set the piston's motion and the steps of the present stage, and make the stage's first record."""
        stage, progress, scales = self.stage, self.progress, self.system.scales
        if self.ledger is None:
            first = self.present_record(ARRANGE)[: self._ledger_columns]
            self.ledger = EnergyLedger.from_first_record(
                first, coarse=has_depaula_friction_or_pair_list(self.scene)
            )
        by = stage.initial_jump(float(self.state.piston[HEIGHT]) * scales.length)
        if by:
            self._jump_piston(by / scales.length)
        progress.height = float(self.state.piston[HEIGHT]) * scales.length
        with name_stage_in_errors(stage, f"at t = {progress.start * scales.time:g} s"):
            self.motion = stage.piston_motion(progress.height, scales)
        if not self.motion.free:
            self._set_prescribed_speed(driven_height_and_velocity(self.motion, 0.0)[1])
        row = self.present_record(ARRANGE)
        hold_present_far_field(self.state)
        self.set_step_schedule(row)
        self.band[:] = (0.0, row[columns.HEIGHT], row[columns.HEIGHT])
        self.seen[STIFFEST] = self.seen[LATEST] = 0.0
        progress.started = True
        # Without a jump, the last record of the previous stage is the first one of this stage.
        if by or not progress.results:
            self._record_rows(row[None])
            self._record_frame()

    def _jump_piston(self, by: float) -> None:
        before = self.total_energy(ARRANGE)
        self.state.piston[HEIGHT] += by
        self._let_cell_recoil(by, 0.0)
        moved = f"stage {self.stage.name!r} moves the piston into the bed; choose a greater final height"
        self.state.ledger[WORK] += self.total_energy(moved) - before

    def _set_prescribed_speed(self, speed: float) -> None:
        """Set the prescribed speed of the piston, and add the work of the drive to the energy balance."""
        mass, piston = self.grain_constants.piston_mass, self.state.piston
        if self.scene.effects.host is not None:  # the carrying structure takes part of the momentum
            before = self.total_energy(ARRANGE)
            self._let_cell_recoil(0.0, speed - float(piston[SPEED]))
            piston[SPEED] = speed
            self.state.ledger[WORK] += self.total_energy(ARRANGE) - before
        elif math.isfinite(mass):
            self.state.ledger[WORK] += 0.5 * mass * (speed**2 - piston[SPEED] ** 2)
        piston[SPEED] = speed

    def _let_cell_recoil(self, height: float, speed: float) -> None:
        """Let a cell on a host (its carrier) recoil from a jump of the piston; the grains do not move."""
        law = self.grain_constants.acting.host
        if law is None:
            return
        state, present = self.state, slice(self.grain_constants.grains)
        by = law.recoil * np.array([height, speed])
        state.bodies[CELL, [HEIGHT, SPEED]] -= by
        state.bodies[PISTON + 1 :, [HEIGHT, SPEED]] += by
        state.y[present] += by[0]
        state.vy[present] += by[1]

    # Advancing ---------------------------------------------------------------------------------

    def advance(self) -> None:
        """Call the compiled loop once; record and check its results."""
        progress = self.progress
        if not progress.started:
            self.begin_stage()
            if self.is_at_end:
                return
        ticks = self.tick_count_of_next_call()
        if ticks > 0:
            self._call_compiled_loop(min(ticks, 1 if self.threads.trying else self._call_ticks))
        else:
            remaining = self.remaining_stage_time()
            self._advance_rest_of_stage(remaining)
            between = progress.ticks % self.schedule.frames_every != 0
            self._finish_stage("duration", new_frame=between or remaining > 0.0)

    def _run_ticks(self, window: TickRange, schedule: StepSchedule, watch: StopCriteria) -> TickOutcome:
        """Run ticks; return status, number of ticks done, and records with an extra row for the last tick."""
        rows = self.call_engine(window, schedule, watch)
        self.progress.ticks += rows.done
        if rows.status == OUTSIDE:
            self._record_rows(rows.records[:-1])
            raise self.misplaced_grain_error(self.remedy_for_long_steps)
        return rows

    def _call_compiled_loop(self, ticks: int) -> None:
        progress, schedule = self.progress, self.schedule
        window = TickRange(progress.start, 0.0, self.stage_duration, progress.ticks, ticks)
        started = time.perf_counter()
        status, done, rows = self._run_ticks(window, schedule, self.stop_criteria())
        seconds = time.perf_counter() - started
        if done and seconds > 0.0:
            self._call_ticks = max(1, round(CALL_SECONDS * done / seconds))
            self.threads.note_step_time_and_choose_count(done * schedule.steps, seconds)
        on_record = progress.ticks % schedule.every == 0
        last = rows[-2] if on_record else rows[-1]
        progress.stiffest = max(progress.stiffest, last[columns.STIFFEST] * schedule.h)
        self._record_rows(rows[:-1])
        if progress.ticks % schedule.frames_every == 0:
            self._record_frame()
        if status in (RESTING, REACHED):
            if not on_record:
                self._record_rows(last[None])
            reason = "rest" if status == RESTING else "force"
            self._finish_stage(reason, new_frame=progress.ticks % schedule.frames_every != 0)
        elif status == REMOVED:
            self._remove_outflow()
        elif status == STIFF:
            self.set_steps_per_tick(self.seen[LATEST])
        elif progress.ticks % REVIEW == 0:
            if self.step.is_automatic and self._has_damping_effects:
                self.set_steps_per_tick(self.seen[STIFFEST])
            if self._has_damping_effects:
                hold_present_far_field(self.state)
            self.seen[STIFFEST] = 0.0

    @property
    def _has_damping_effects(self) -> bool:
        return any(effect.damps for effect in self.system.effects)

    def _remove_outflow(self) -> None:
        """Remove grains that have left through the opening, and count their energy as negative work."""
        before, state, scales = self.total_energy(self.remedy_for_long_steps), self.state, self.system.scales
        for i in np.flatnonzero(state.y[: self.grain_constants.grains] < self.grain_constants.exit):
            position = [float(values[i]) * scales.length for values in (state.x, state.y)]
            self.progress.departures.append([int(state.label[i]), self.present_time * scales.time, *position])
        self.grain_constants = remove_outflowed_grains(self.state, self.grain_constants)
        self.state.ledger[WORK] += self.total_energy(self.remedy_for_long_steps) - before

    def _advance_rest_of_stage(self, remaining: float) -> None:
        """Advance by the remainder of a stage or run after its last whole tick, in slightly shorter steps."""
        if not remaining > 0.0:  # the end coincides with a tick, perhaps between two records
            if self.progress.ticks % self.schedule.every:
                self._record_rows(self.present_record(self.remedy_for_long_steps)[None])
            return
        schedule, reached = self.schedule, float(self.state.clock[TIME])
        steps = max(1, math.ceil(remaining / schedule.h - 1e-6))
        watch = self.stop_criteria()._replace(rest=-1.0, stiff=math.inf)
        if self.tables.fraction is None:
            window = TickRange(self.progress.start, reached, math.inf, 0, 1)
            shortened = StepSchedule(remaining, remaining / steps, 1, 1, steps, 0)
            _, made, rows = self._run_ticks(window, shortened, watch)
            self.state.clock[TIME] = reached + remaining
            rows = rows[:1]
        else:
            limit, first = reached + remaining, self.progress.ticks
            ticks = max(1, math.ceil(limit / schedule.length - 1e-9) - first)
            window = TickRange(self.progress.start, 0.0, limit, first, ticks)
            _, made, rows = self._run_ticks(window, schedule, watch)
            rows = rows[:-1] if self.progress.ticks % schedule.every == 0 else rows
        self.progress.ticks -= made
        self._record_rows(rows)

    def finish_last_partial_tick_and_return_end(self) -> float:
        """Run the partial tick between the last snapshot and ``t_end``; return the end [tau]."""
        if self.is_protocol_finished or not self.progress.started:
            return self.progress.start
        remaining = self.t_end - self.present_time
        if remaining > self.time_rounding_limit():
            self._advance_rest_of_stage(remaining)
            self._record_frame(self.t_end)
            return self.t_end
        self._advance_rest_of_stage(0.0)
        if self.progress.ticks % self.schedule.frames_every:
            self._record_frame()
        return self.present_time

    def _finish_stage(self, reason: str, *, new_frame: bool) -> None:
        progress, stage = self.progress, self.stage
        if reason == "duration" and isinstance(stage, TimedStage) and stage.until == "rest":
            state, scales = self.state, self.system.scales
            fastest = float(np.hypot(state.vx, state.vy).max(initial=0.0))
            raise not_at_rest_error(
                stage.name,
                stage.maximum_duration(0.0) or 0.0,
                (abs(float(state.piston[SPEED])) * scales.velocity, fastest * scales.velocity),
                self.stop_criteria().rest * scales.length,
                self.step_count,
                self.present_time * scales.time,
            )
        end = progress.last
        final = stage.prescribed_final_height() if reason == "duration" else None
        if final is not None:
            self.state.piston[HEIGHT] = final / self.system.scales.length
        height, spread = float(self.state.piston[HEIGHT]), 0.0
        if reason == "rest":
            height = 0.5 * (self.band[LOWEST] + self.band[HIGHEST])
            spread = self.band[HIGHEST] - self.band[LOWEST]
        if new_frame:
            self._record_frame(end)
        progress.results.append(self._stage_result(reason, end, height, spread))
        progress.start = end
        progress.stage += 1
        progress.started = False
        progress.ticks = 0
        progress.schedule = None
        self.state.clock[TIME] = 0.0

    def _stage_result(self, reason: str, end: float, height: float, spread: float) -> dict[str, Any]:
        scales = self.system.scales
        return {
            "name": self.stage.name,
            "start": self.progress.start * scales.time,
            "end": end * scales.time,
            "reason": reason,
            "height": height * scales.length,
            "spread": spread * scales.length,
        }

    def stage_results(self, until: float) -> list[dict[str, Any]]:
        """Return the results of all finished stages and, up to ``until`` [tau], of the present stage."""
        if not self.progress.started:
            return list(self.progress.results)
        cut = self._stage_result("cut", until, float(self.state.piston[HEIGHT]), 0.0)
        return [*self.progress.results, cut]

    # Records and failures ----------------------------------------------------------------------

    def _record_rows(self, rows: np.ndarray) -> None:
        if not len(rows):
            return
        assert self.ledger is not None
        unbalanced = self.ledger.enter_records_and_find_unbalanced(rows[:, : self._ledger_columns])
        self.progress.closest = min(self.progress.closest, float(rows[:, columns.CLOSEST].min()))
        self.progress.last = float(rows[-1, columns.TIME])
        recorded = len(rows) if unbalanced is None else unbalanced[0] + 1
        self.recorder.add_records(rows[:recorded], self.progress.stage)
        if unbalanced is not None:
            seconds = self.system.scales.time
            moment = float(rows[unbalanced[0], columns.TIME]) * seconds
            row = rows[unbalanced[0], None]
            turnover = columns.total_energies(row) + columns.total_losses(row) + row[:, columns.WORK]
            error: RunError = EnergyError(
                f"the energy balance is off by {unbalanced[1]:.2g} of the energy turned over; "
                f"the limit is {self.ledger.wrong:g}",
                step=self.step_count,
                time=moment,
                value=unbalanced[1],
                remedy=self.remedy_for_long_steps,
            )
            if not np.isfinite(turnover).all():
                cause, remedy = "an energy is no longer finite", self.remedy_for_non_finite
                error = NotFiniteError(cause, step=self.step_count, time=moment, remedy=remedy)
            raise error.with_context(self.too_long_step_text)

    def _record_frame(self, time: float | None = None) -> None:
        moment = self.present_time if time is None else time
        self.recorder.add_frame(moment, self.state, self.grain_constants)
