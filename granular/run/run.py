"""One run: the stages of a protocol, one after another, from the last checkpoint or the start."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from typing import Any

import numpy as np

from granular.engine import columns
from granular.engine.checkpoint import Progress, entries_of_former, kept_arrays, put_arrays
from granular.engine.departure import grain_constants, take_out
from granular.engine.failures import countless, misplaced, restless, unbalanced
from granular.engine.far import hold_far_field
from granular.engine.ledger import Ledger, is_coarse
from granular.engine.loop import (
    DEPARTED,
    HIGHEST,
    LATEST,
    LOWEST,
    OUTSIDE,
    REACHED,
    RESTING,
    STIFF,
    STIFFEST,
    TURNED,
    Watch,
    Window,
    advance,
    look,
)
from granular.engine.state import (
    HEIGHT,
    SPEED,
    WORK,
    Measurement,
    State,
    new_measurement,
    new_state,
)
from granular.engine.step import plan_of
from granular.engine.step_size import (
    MOST_COUNT,
    MOST_STEPS,
    REVIEW,
    Pace,
    Step,
    multiple,
    whole_ticks,
)
from granular.engine.stiffness import collision_frequency
from granular.engine.system import System
from granular.engine.variable import LONGEST, SHORTEST, STEPS, TIME, open_density
from granular.methods import Method
from granular.protocol import Stage
from granular.protocol.motion import Motion, drive_frequency, greatest_speed, path
from granular.protocol.stage import Timed, stage_motion
from granular.run.recorder import Recorder
from granular.scene.scene import Scene
from granular.shared.errors import RunError, StoreError

CALL_SECONDS = 0.1
"""Length of one call of the compiled loop: how long an interruption may have to wait."""

DECAY_LIMIT = 10.0
"""A decay by drag is resolved as far as it is at most this much faster than the stiffest mode (or
than one that a step from record to record would resolve): a faster one leaves grains that creep,
which the exact flow of drag carries at any step."""

REST_TOLERANCE = 1e-4
"""Rest where the stage gives no tolerance [D], [D/tau]."""

_PLACE = "place the grains apart from each other, inside the walls and below the piston"


class Run:
    """The engine's working object: state, progress and recorder, advanced call by call."""

    def __init__(
        self, scene: Scene, system: System, method: Method, step: Step, t_end: float | None
    ) -> None:
        self.scene, self.system, self.step = scene, system, step
        self.t_end = math.inf if t_end is None else t_end / system.scales.time
        self.plan = plan_of(method, step, system.constants.acting.far)
        self.recorder = Recorder(scene.grains.count, system.effects)
        self.progress = Progress()
        positions, velocities = scene.initial_motion()
        height = scene.piston.height if scene.piston is not None else 0.0
        scales = system.scales
        self.state: State = new_state(
            positions / scales.length,
            velocities / scales.velocity,
            height / scales.length,
            system.constants.acting,
            method,
        )
        self.constants = system.constants
        self.measurement: Measurement = new_measurement(self.state)
        self.band, self.seen = np.zeros(3), np.zeros(3)
        self.ledger: Ledger | None = None
        self.motion = Motion()
        self._columns = columns.width(len(system.effects))
        self._row = np.zeros(self._columns)
        self._call_ticks = 1

    # Checkpoints -------------------------------------------------------------------------------

    def snapshot(self) -> dict[str, Any]:
        """All that is needed to go on from here, as arrays."""
        kept = kept_arrays(self.state) | {"band": self.band.copy(), "seen": self.seen.copy()}
        memory = {
            "progress": dataclasses.asdict(self.progress),
            "ledger": None if self.ledger is None else dataclasses.asdict(self.ledger),
            "grains": self.constants.grains,
        }
        return kept | {"memory": np.array(json.dumps(memory))}

    def restore(self, kept: dict[str, np.ndarray]) -> None:
        """Go back to a snapshot.

        Raises
        ------
        StoreError
            If the run has gone farther than its end is now to be, or the checkpoint lacks an array.
        """
        state = self.state
        if "entries" not in kept and "ledger" in kept:
            names = [effect.key for effect in self.system.effects]
            kept = {**kept, "entries": entries_of_former(kept["ledger"], names)}
        missing = set(kept_arrays(state)) - set(kept)
        if missing:
            raise StoreError(
                f"the run's checkpoint holds no {min(missing)!r}: another version made it; give a "
                "new directory"
            )
        put_arrays(state, kept)
        self.band[:], self.seen[:] = kept["band"], kept["seen"]
        memory = json.loads(str(kept["memory"]))
        self.progress = Progress(**memory["progress"])
        self.ledger = None if memory["ledger"] is None else Ledger(**memory["ledger"])
        for values in grain_constants(self.constants):
            values[:] = values[state.label[: len(values)]]
        self.constants = self.constants._replace(grains=memory["grains"])
        if self.progress.begun:
            height, scales = self.progress.height, self.system.scales
            self.motion = stage_motion(self.scene.protocol, self._stage, height, scales)
        # What is not kept follows from the positions; what is kept has the bits of the pass that
        # made it, which may have been a measuring one.
        self._look(_PLACE)
        put_arrays(state, kept)
        self._check_end()

    def _check_end(self) -> None:
        """Whether the run can still end where it is to end."""
        seconds = self.system.scales.time
        ahead = self.t_end * (1.0 + 1e-9) if math.isfinite(self.t_end) else math.inf
        if self.time > ahead:
            raise StoreError(
                f"the run has reached {self.time * seconds:g} s already, t_end = "
                f"{self.t_end * seconds:g} s lies before; give a later one"
            )
        last = self.scene.protocol[-1]
        longer = isinstance(last, Timed) and last.until is None and math.isfinite(self.t_end)
        if self.finished and longer and self.time < self.t_end * (1.0 - 1e-9):
            raise StoreError(
                f"the protocol of this run has ended, at {self.time * seconds:g} s; "
                f"t_end = {self.t_end * seconds:g} s needs a new run"
            )
        if not self.finished and self.progress.begun and self._rest_of_stage(0) < 0.0:
            raise StoreError(
                f"the run has gone on to {self.time * seconds:g} s, behind the end of stage "
                f"{self._stage.name!r}; give a t_end from there on"
            )

    # Stages ------------------------------------------------------------------------------------

    @property
    def _stage(self) -> Stage:
        return self.scene.protocol[self.progress.stage]

    @property
    def total(self) -> float:
        """Length of the present stage [tau]; infinite where only ``t_end`` ends it."""
        stage = self._stage
        span = stage.span(self.progress.height)
        last = self.progress.stage == len(self.scene.protocol) - 1
        timed = isinstance(stage, Timed) and stage.until is None
        if span is None or (last and timed and math.isfinite(self.t_end)):
            return math.inf
        return span / self.system.scales.time

    @property
    def time(self) -> float:
        """Present time [tau], at the last whole tick."""
        return self.progress.start + float(self.state.clock[TIME])

    @property
    def steps(self) -> int:
        return int(self.state.clock[STEPS])

    @property
    def finished(self) -> bool:
        return self.progress.stage == len(self.scene.protocol)

    def figures(self) -> dict[str, Any]:
        """What a user should know of how the run went."""
        scales, progress, clock = self.system.scales, self.progress, self.state.clock
        figures: dict[str, Any] = {
            "steps": self.steps,
            "ledger_residual": 0.0 if self.ledger is None else self.ledger.closure,
        }
        if self.steps:
            figures["shortest_step"] = float(clock[SHORTEST]) * scales.time
            figures["longest_step"] = float(clock[LONGEST]) * scales.time
        if self.plan.fraction is None:
            figures["step_times_highest_frequency"] = progress.stiffest
        if math.isfinite(progress.closest):
            figures["closest_distance"] = progress.closest * scales.length
        return figures

    def _look(self, remedy: str) -> np.ndarray:
        """Forces and a record of the present moment."""
        moved = self.progress.start, self.plan, self.state, self.constants, self.motion
        outside = look(*moved, self.measurement, self._row)
        self._row[columns.TURNED] = self.seen[TURNED]
        if outside:
            raise self.misplaced(remedy)
        return self._row

    def begin_stage(self) -> None:
        """Set up the present stage: its motion, its pace, and its first record."""
        stage, progress, scales = self._stage, self.progress, self.system.scales
        progress.ticks = 0
        progress.pace = None
        self.state.clock[TIME] = 0.0
        self._open_ledger()
        by = stage.jump(float(self.state.piston[HEIGHT]) * scales.length)
        if by:
            self._jump(by / scales.length)
        progress.height = float(self.state.piston[HEIGHT]) * scales.length
        self.motion = stage_motion(self.scene.protocol, stage, progress.height, scales)
        if not self.motion.free:
            self._take_hold(path(self.motion, 0.0)[1])
        row = self._look(_PLACE)
        hold_far_field(self.state)
        self._set_pace(row)
        self.band[:] = (0.0, row[columns.HEIGHT], row[columns.HEIGHT])
        self.seen[STIFFEST] = self.seen[LATEST] = 0.0
        progress.begun = True
        # Where nothing jumped, the last record of the stage before is the first one of this.
        if by or not progress.results:
            self._keep(row[None])
            self._frame()

    def _open_ledger(self) -> None:
        if self.ledger is None:
            row = self._look(_PLACE)
            self.ledger = Ledger.opened(row, coarse=is_coarse(self.scene))

    def _jump(self, by: float) -> None:
        before = columns.energy(self._look(_PLACE))
        self.state.piston[HEIGHT] += by
        moved = f"stage {self._stage.name!r} sets the piston into the bed; let it end higher"
        self.state.ledger[WORK] += columns.energy(self._look(moved)) - before

    def _take_hold(self, speed: float) -> None:
        """Give the piston the speed of its path; the hand that drives it does the work."""
        mass, piston = self.constants.piston_mass, self.state.piston
        if math.isfinite(mass):
            self.state.ledger[WORK] += 0.5 * mass * (speed**2 - piston[SPEED] ** 2)
        piston[SPEED] = speed

    def _set_pace(self, row: np.ndarray) -> None:
        """Cut the stage into ticks, by the speeds that the bed can reach from its start."""
        output, scales = self.scene.output, self.system.scales
        gravity = self.system.pull
        # A grain may still gain what it loses in height.
        top = float(self.state.y[: self.constants.grains].max(initial=0.0))
        speed = math.sqrt(row[columns.FASTEST] ** 2 + 2.0 * gravity * top)
        height, falling = self.state.piston[HEIGHT], self.state.piston[SPEED]
        speed += greatest_speed(self.motion, self.constants.piston_mass, gravity, height, falling)
        speed += sum(one.greatest_speed(scales) for one in self.system.effects)
        frequency = max(float(row[columns.STIFFEST]), collision_frequency(self.constants, speed))
        pace = self.step.pace(
            output.scalars / scales.time,
            output.frames / scales.time,
            self._resolved(frequency),
            scales.time,
        )
        self._use(pace)
        end = min(self.total, self.t_end - self.progress.start)
        self._check_count("the way to the end", end / pace.h if end < math.inf else 0.0, MOST_COUNT)
        if self.plan.fraction is not None:
            open_density(speed, 0.5 * pace.length, self.plan.fraction, self.state, self.constants)

    def _check_count(self, what: str, steps: float, limit: float) -> None:
        if not steps <= limit:
            seconds = self.time * self.system.scales.time
            raise countless(what, steps, limit, self.steps, seconds)

    def _resolved(self, frequency: float) -> float:
        """The frequency that an automatic step is to resolve, with the drive and the drag."""
        scales, effects = self.system.scales, self.system.effects
        rate = max((one.decay_rate(scales) for one in effects), default=0.0)
        record = self.scene.output.scalars / scales.time
        slowest = max(frequency, self.step.fraction / record)
        drive = max(
            [drive_frequency(self.motion), *(one.drive_frequency(scales) for one in effects)]
        )
        resolved = max(frequency, drive, min(rate, DECAY_LIMIT * slowest))
        steps = record * resolved / self.step.fraction
        if self.step.automatic:
            self._check_count("the time from record to record", steps, MOST_STEPS)
        return resolved

    def _use(self, pace: Pace) -> None:
        self.progress.pace = list(pace)
        if self.plan.fraction is None:
            clock = self.state.clock
            clock[SHORTEST] = min(clock[SHORTEST], pace.h)
            clock[LONGEST] = max(clock[LONGEST], pace.h)

    @property
    def pace(self) -> Pace:
        assert self.progress.pace is not None
        return Pace(*self.progress.pace)

    def _watch(self) -> Watch:
        stage, pace, scales = self._stage, self.pace, self.system.scales
        rest, window = -1.0, 0
        if isinstance(stage, Timed) and stage.until == "rest":
            rest = REST_TOLERANCE
            if stage.tolerance is not None:
                rest = stage.tolerance / scales.length
            window = math.ceil(min(stage.window / scales.time / pace.length, MOST_COUNT))
        stiff = self.step.stiff if self.plan.fraction is None else math.inf
        assert self.ledger is not None
        potential, piston = self.ledger.potential, self.ledger.piston
        floor = -math.inf if self.scene.piston is None else 0.0
        return Watch(stiff, rest, window, self.band, self.seen, potential, piston, floor)

    # Advancing ---------------------------------------------------------------------------------

    def advance(self) -> None:
        """One call of the compiled loop, and the bookkeeping after it.

        Raises
        ------
        RunError
            If the run cannot be trusted any more.
        """
        progress = self.progress
        if not progress.begun:
            self.begin_stage()
            if self.at_end:
                return
        ticks = self._whole_ticks()
        if ticks > 0:
            self._call(min(ticks, self._call_ticks))
        else:
            left = self._rest_of_stage()
            self._short_tick(left)
            between = progress.ticks % self.pace.frames_every != 0
            self._end_stage("duration", new_frame=between or left > 0.0)

    @property
    def at_end(self) -> bool:
        """Whether nothing but the unfinished tick before ``t_end`` is left."""
        progress = self.progress
        if self.finished:
            return True
        if not progress.begun:
            return progress.start >= self.t_end * (1.0 - 1e-12) and bool(progress.results)
        before_end = self._ticks_to(self.total) > 0 or self._rest_of_stage() > 0.0
        return before_end and self._ticks_to_end() <= 0

    def _ticks_to(self, time: float) -> float:
        """Whole ticks that are left to a time in the stage."""
        return whole_ticks(self.pace, time) - self.progress.ticks

    def _ticks_to_end(self) -> float:
        """Whole ticks that are left to ``t_end``.

        A variable step may end behind its tick, and one that is cut at ``t_end`` is no state to go
        on from: the last two ticks are left to the tail.
        """
        spared = 0.0 if self.plan.fraction is None else 2.0
        return self._ticks_to(self.t_end - self.progress.start) - spared

    def _rest_of_stage(self, least: float = 1e-6) -> float:
        """Time [tau] left of the stage behind its last whole tick; 0 below ``least`` steps."""
        total = self.total
        if math.isinf(total):
            return 0.0
        left = total - float(self.state.clock[TIME])
        if left > self._least(least) or left < -1e-6 * self.pace.length:
            return left
        return 0.0

    def _least(self, share: float = 1e-6) -> float:
        """A time [tau] below which rounding leaves something to an end that was reached."""
        return share * self.pace.h if self.progress.ticks else 0.0

    def _whole_ticks(self) -> int:
        ticks, pace = self.progress.ticks, self.pace
        to_frame = pace.frames_every - ticks % pace.frames_every
        to_review = REVIEW - ticks % REVIEW
        left = min(
            self._ticks_to(self.total),
            self._ticks_to_end(),
            to_frame,
            to_review,
        )
        return int(left)

    def _run(self, window: Window, pace: Pace, watch: Watch) -> tuple[int, int, np.ndarray]:
        """Status, ticks made and records of one call; the row behind them holds the last tick."""
        rows = np.empty((window.ticks // pace.every + 2, self._columns))
        status, done, kept = advance(
            window, pace, self.plan, self.state, self.constants, self.motion,
            self.measurement, watch, rows,
        )  # fmt: skip
        self.progress.ticks += done
        if status == OUTSIDE:
            self._keep(rows[:kept])
            raise self.misplaced(self.shorter)
        return status, done, rows[: kept + 1]

    def _call(self, ticks: int) -> None:
        progress, pace = self.progress, self.pace
        window = Window(progress.start, 0.0, self.total, progress.ticks, ticks)
        begun = time.perf_counter()
        status, done, rows = self._run(window, pace, self._watch())
        seconds = time.perf_counter() - begun
        if done and seconds > 0.0:
            self._call_ticks = max(1, round(CALL_SECONDS * done / seconds))
        on_record = progress.ticks % pace.every == 0
        last = rows[-2] if on_record else rows[-1]
        progress.stiffest = max(progress.stiffest, last[columns.STIFFEST] * pace.h)
        self._keep(rows[:-1])
        if progress.ticks % pace.frames_every == 0:
            self._frame()
        if status in (RESTING, REACHED):
            if not on_record:
                self._keep(last[None])
            reason = "rest" if status == RESTING else "force"
            self._end_stage(reason, new_frame=progress.ticks % pace.frames_every != 0)
        elif status == DEPARTED:
            self._let_go()
        elif status == STIFF:
            self._set_steps(self.seen[LATEST])
        elif progress.ticks % REVIEW == 0:
            if self.step.automatic and self._dissipates:
                self._set_steps(self.seen[STIFFEST])
            if self._dissipates:
                hold_far_field(self.state)
            self.seen[STIFFEST] = 0.0

    @property
    def _dissipates(self) -> bool:
        return any(effect.damps for effect in self.system.effects)

    def _let_go(self) -> None:
        """Take out the grains that have left through the gap, with the energy they carry."""
        before = columns.energy(self._look(self.shorter))
        self.constants = take_out(self.state, self.constants)
        self.state.ledger[WORK] += columns.energy(self._look(self.shorter)) - before

    def _set_steps(self, frequency: float) -> None:
        if self.plan.fraction is None:
            self._use(
                self.pace.with_steps(
                    self.step.steps_of(self.pace.length, self._resolved(frequency))
                )
            )

    def _short_tick(self, left: float) -> None:
        """The rest of a stage that is no whole tick, in steps that are a little shorter."""
        if not left > 0.0:  # the end falls on a tick, which may lie between two records
            if self.progress.ticks % self.pace.every:
                self._keep(self._look(self.shorter)[None])
            return
        pace, reached = self.pace, float(self.state.clock[TIME])
        steps = max(1, math.ceil(left / pace.h - 1e-6))
        watch = self._watch()._replace(rest=-1.0, stiff=math.inf)
        if self.plan.fraction is None:
            window = Window(self.progress.start, reached, math.inf, 0, 1)
            _, made, rows = self._run(window, Pace(left, left / steps, 1, 1, steps, 0), watch)
            self.state.clock[TIME] = reached + left
            rows = rows[:1]
        else:
            limit, first = reached + left, self.progress.ticks
            ticks = max(1, math.ceil(limit / pace.length - 1e-9) - first)
            window = Window(self.progress.start, 0.0, limit, first, ticks)
            _, made, rows = self._run(window, pace, watch)
            rows = rows[:-1] if self.progress.ticks % pace.every == 0 else rows
        self.progress.ticks -= made
        self._keep(rows)

    def run_tail(self) -> float:
        """Run the part of a tick before ``t_end`` and take a last frame; the time reached [tau].

        A snapshot to resume from is taken before this.
        """
        if self.finished or not self.progress.begun:
            return self.progress.start
        left = self.t_end - self.time
        if left > self._least():
            self._short_tick(left)
            self._frame(self.t_end)
            return self.t_end
        self._short_tick(0.0)
        if self.progress.ticks % self.pace.frames_every:
            self._frame()
        return self.time

    def _end_stage(self, reason: str, *, new_frame: bool) -> None:
        progress, stage = self.progress, self._stage
        if reason == "duration" and isinstance(stage, Timed) and stage.until == "rest":
            seconds = self.system.scales.time
            spread = float(self.band[HIGHEST] - self.band[LOWEST]) * self.system.scales.length
            raise restless(
                stage.name, stage.span(0.0) or 0.0, spread, self.steps, self.time * seconds
            )
        end = progress.last
        final = stage.final_height() if reason == "duration" else None
        if final is not None:
            self.state.piston[HEIGHT] = final / self.system.scales.length
        height, spread = float(self.state.piston[HEIGHT]), 0.0
        if reason == "rest":
            height = 0.5 * (self.band[LOWEST] + self.band[HIGHEST])
            spread = self.band[HIGHEST] - self.band[LOWEST]
        if new_frame:
            self._frame(end)
        progress.results.append(self._result(reason, end, height, spread))
        progress.start = end
        progress.stage += 1
        progress.begun = False
        progress.ticks = 0
        progress.pace = None
        self.state.clock[TIME] = 0.0

    def _result(self, reason: str, end: float, height: float, spread: float) -> dict[str, Any]:
        scales = self.system.scales
        return {
            "name": self._stage.name,
            "start": self.progress.start * scales.time,
            "end": end * scales.time,
            "reason": reason,
            "height": height * scales.length,
            "spread": spread * scales.length,
        }

    def results(self, until: float) -> list[dict[str, Any]]:
        """The finished stages, and the present one, cut at the time ``until`` [tau]."""
        if not self.progress.begun:
            return list(self.progress.results)
        cut = self._result("cut", until, float(self.state.piston[HEIGHT]), 0.0)
        return [*self.progress.results, cut]

    # Records and failures ----------------------------------------------------------------------

    def _keep(self, rows: np.ndarray) -> None:
        if not len(rows):
            return
        assert self.ledger is not None
        wrong = self.ledger.check(rows)
        self.progress.closest = min(self.progress.closest, float(rows[:, columns.CLOSEST].min()))
        self.progress.last = float(rows[-1, columns.TIME])
        good = len(rows) if wrong is None else wrong[0] + 1
        self.recorder.add_rows(rows[:good], self.progress.stage)
        if wrong is not None:
            seconds = self.system.scales.time
            moment = float(rows[wrong[0], columns.TIME]) * seconds
            raise unbalanced(wrong[1], self.ledger.wrong, self.steps, moment, self.shorter)

    def _frame(self, at: float | None = None) -> None:
        moment = self.time if at is None else at
        self.recorder.add_frame(moment, self.state, self.constants)

    @property
    def shorter(self) -> str:
        """What to do about steps that are too long."""
        if self.step.automatic:
            return f"shorten dt (for instance {multiple(0.25 * self.step.factor)!r})"
        return "shorten dt (or leave it 'auto')"

    def misplaced(self, remedy: str) -> RunError:
        scales = self.system.scales
        return misplaced(
            self.state, self.constants, scales, self.steps, self.time * scales.time, remedy
        )
