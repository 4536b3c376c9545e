"""One run: the stages of a protocol, one after another, from the last checkpoint or the start."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from typing import Any

import numpy as np

from granular.arrangement import initial_motion
from granular.engine.forces import measure_forces
from granular.engine.ledger import Ledger
from granular.engine.loop import (
    CLOSEST,
    COLUMNS,
    FASTEST,
    LEFT,
    OUTSIDE,
    REACHED,
    RESTING,
    STIFF,
    STIFFEST,
    Watch,
    advance,
    measure,
)
from granular.engine.motion import Motion, path
from granular.engine.state import (
    KEPT,
    WORK,
    Measurement,
    State,
    new_measurement,
    new_state,
)
from granular.engine.step_size import REVIEW, Pace, Step
from granular.engine.stiffness import collision_frequency
from granular.engine.system import System
from granular.errors import EnergyError, NotAtRestError, NotFiniteError, OutsideError, RunError
from granular.methods import Method
from granular.pairs.direct import PADDING
from granular.protocol import Stage
from granular.protocol.stage import Timed
from granular.recorder import Recorder
from granular.scene import Scene

CALL_SECONDS = 0.1
"""Length of one call of the compiled loop: how long an interruption may have to wait."""

REST_TOLERANCE = 1e-4
"""Rest where the stage gives no tolerance [D], [D/tau]."""


@dataclasses.dataclass
class Progress:
    """Where a run stands; with the state's arrays, all that a checkpoint needs.

    Attributes
    ----------
    stage, ticks, steps : int
        Present stage (its index), ticks made in it, steps made in all.
    begun : bool
        Whether the present stage has been set up.
    start, last : float
        Start of the stage, and time of the last record [tau].
    height : float
        Piston height at the stage's start [m].
    pace : dict
        Fields of its `Pace`.
    stiffest : float
        Greatest product of step and highest angular frequency so far.
    closest : float
        Least distance of two grains so far [D].
    results : list of dict
        Fields of the `StageResult` of each finished stage.
    """

    stage: int = 0
    ticks: int = 0
    steps: int = 0
    begun: bool = False
    start: float = 0.0
    last: float = 0.0
    height: float = 0.0
    pace: dict[str, Any] = dataclasses.field(default_factory=dict)
    stiffest: float = 0.0
    closest: float = math.inf
    results: list[dict[str, Any]] = dataclasses.field(default_factory=list)


class Run:
    """The engine's working object: state, progress and recorder, advanced call by call."""

    def __init__(
        self, scene: Scene, system: System, method: Method, step: Step, t_end: float | None
    ) -> None:
        self.scene, self.system, self.method = scene, system, method
        self.step = step
        self.t_end = math.inf if t_end is None else t_end / system.scales.time
        self.kicks, self.drifts = method.tables()
        self.recorder = Recorder(scene.grains.count)
        self.progress = Progress()
        positions, velocities = initial_motion(scene)
        height = scene.piston.height if scene.piston is not None else 0.0
        scales = system.scales
        self.state: State = new_state(
            positions / scales.length,
            velocities / scales.velocity,
            height / scales.length,
            system.constants.acting,
        )
        self.constants = system.constants
        self.measurement: Measurement = new_measurement(self.state)
        self.band, self.seen = np.zeros(3), np.zeros(2)
        self.ledger: Ledger | None = None
        self.motion = Motion()
        self._row = np.zeros(len(COLUMNS))
        self._call_ticks = 1

    # Checkpoints -------------------------------------------------------------------------------

    def snapshot(self) -> dict[str, Any]:
        """All that is needed to go on from here, as arrays."""
        kept = {name: getattr(self.state, name).copy() for name in KEPT}
        kept |= {"band": self.band.copy(), "seen": self.seen.copy()}
        memory = {
            "progress": dataclasses.asdict(self.progress),
            "ledger": None if self.ledger is None else dataclasses.asdict(self.ledger),
            "grains": self.constants.grains,
        }
        return kept | {"memory": np.array(json.dumps(memory))}

    def restore(self, kept: dict[str, np.ndarray]) -> None:
        """Go back to a snapshot."""
        for name in KEPT:
            getattr(self.state, name)[:] = kept[name]
        self.band[:], self.seen[:] = kept["band"], kept["seen"]
        memory = json.loads(str(kept["memory"]))
        self.progress = Progress(**memory["progress"])
        self.ledger = None if memory["ledger"] is None else Ledger(**memory["ledger"])
        for values in self._grain_constants():
            values[:] = values[self.state.label[: len(values)]]
        self.constants = self.constants._replace(grains=memory["grains"])
        if self.progress.begun:
            self.motion = self._stage.motion(self.progress.height, self.system.scales)

    def _grain_constants(self) -> list[np.ndarray]:
        """The constants that hold a value a grain; they move with the grains."""
        acting = self.constants.acting
        found = [] if self.constants.charge is None else [self.constants.charge]
        if acting.friction is not None:
            found += [acting.friction.factor, acting.friction.weight]
        if acting.contact is not None:
            found.append(acting.contact.radius)
        return found

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
        return self.progress.start + self.progress.ticks * self.progress.pace.get("length", 0.0)

    @property
    def finished(self) -> bool:
        return self.progress.stage == len(self.scene.protocol)

    def figures(self) -> dict[str, Any]:
        """What a user should know of how the run went."""
        scales, progress = self.system.scales, self.progress
        figures: dict[str, Any] = {
            "steps": progress.steps,
            "ledger_residual": 0.0 if self.ledger is None else self.ledger.closure,
            "step_times_highest_frequency": progress.stiffest,
        }
        if math.isfinite(progress.closest):
            figures["closest_distance"] = progress.closest * scales.length
        return figures

    def _look(self) -> np.ndarray:
        """Forces and a record of the present moment."""
        outside = measure_forces(self.state, self.constants, self.time, self.measurement)
        measure(self.time, self.state, self.constants, self.motion, self.measurement, self._row)
        if outside:
            raise self._failure(0)
        return self._row

    def begin_stage(self) -> None:
        """Set up the present stage: its motion, its pace, and its first record."""
        stage, progress, scales = self._stage, self.progress, self.system.scales
        progress.ticks = 0
        progress.pace = {}
        by = stage.jump(float(self.state.piston[0]) * scales.length)
        if by:
            self._jump(by / scales.length)
        progress.height = float(self.state.piston[0]) * scales.length
        self.motion = stage.motion(progress.height, scales)
        if not self.motion.free:
            self._take_hold(path(self.motion, 0.0)[1])
        row = self._look()
        if self.ledger is None:
            self.ledger = Ledger.opened(row, dry=self.constants.acting.friction is not None)
        progress.pace = dataclasses.asdict(self._pace(row))
        self.band[:] = (0.0, row[1], row[1])
        self.seen[:] = 0.0
        progress.begun = True
        # Where nothing jumped, the last record of the stage before is the first one of this.
        if by or not progress.results:
            self._keep(row[None])
            self._frame()

    def _jump(self, by: float) -> None:
        before = self._energy(self._look())
        self.state.piston[0] += by
        self.state.ledger[1] += self._energy(self._look()) - before

    @staticmethod
    def _energy(row: np.ndarray) -> float:
        return float(row[COLUMNS.index("kinetic") : COLUMNS.index("piston") + 1].sum())

    def _take_hold(self, speed: float) -> None:
        """Give the piston the speed of its path; the hand that drives it does the work."""
        mass, piston = self.constants.mass, self.state.piston
        if math.isfinite(mass):
            self.state.ledger[1] += 0.5 * mass * (speed**2 - piston[1] ** 2)
        piston[1] = speed

    def _pace(self, row: np.ndarray) -> Pace:
        output, scales = self.scene.output, self.system.scales
        record, frame = output.scalars / scales.time, output.frames / scales.time
        # A grain may still gain what it loses in height.
        gravity = self.constants.acting.gravity or 0.0
        top = float(self.state.y[: self.constants.grains].max(initial=0.0))
        speed = math.sqrt(row[FASTEST] ** 2 + 2.0 * gravity * top) + abs(float(row[2]))
        frequency = max(float(row[STIFFEST]), collision_frequency(self.constants, speed))
        return self.step.pace(record, frame, frequency, scales.time)

    @property
    def pace(self) -> Pace:
        return Pace(**self.progress.pace)

    def _watch(self) -> Watch:
        stage, pace, scales = self._stage, self.pace, self.system.scales
        rest, window = -1.0, 0
        if isinstance(stage, Timed) and stage.until == "rest":
            rest = REST_TOLERANCE
            if stage.tolerance is not None:
                rest = stage.tolerance / scales.length
            window = math.ceil(stage.window / scales.time / pace.length)
        return Watch(self.step.stiff, rest, window, self.band, self.seen)

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
            if left > 0.0:
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
        return before_end and self._ticks_to(self.t_end - progress.start) <= 0

    def _ticks_to(self, time: float) -> float:
        """Whole ticks that are left to a time in the stage."""
        if math.isinf(time):
            return math.inf
        return math.floor(time / self.pace.length + 1e-6) - self.progress.ticks

    def _rest_of_stage(self) -> float:
        """What is left of the stage behind its last whole tick [tau]."""
        total = self.total
        if math.isinf(total):
            return 0.0
        left = total - self.progress.ticks * self.pace.length
        return left if left > 1e-6 * self.pace.h else 0.0

    def _whole_ticks(self) -> int:
        ticks, pace = self.progress.ticks, self.pace
        to_frame = pace.frames_every - ticks % pace.frames_every
        to_review = REVIEW - ticks % REVIEW
        left = min(
            self._ticks_to(self.total),
            self._ticks_to(self.t_end - self.progress.start),
            to_frame,
            to_review,
        )
        return int(left)

    def _call(self, ticks: int) -> None:
        progress, pace = self.progress, self.pace
        rows = np.empty((ticks // pace.every + 2, len(COLUMNS)))
        begun = time.perf_counter()
        status, done, kept, step = advance(
            ticks, progress.ticks, pace.length, pace.steps, pace.h, progress.start, pace.every,
            self.kicks, self.drifts, self.state, self.constants, self.motion,
            self.measurement, self._watch(), rows,
        )  # fmt: skip
        seconds = time.perf_counter() - begun
        if done and seconds > 0.0:
            self._call_ticks = max(1, round(CALL_SECONDS * done / seconds))
        progress.ticks += done
        progress.steps += done * pace.steps
        if status == OUTSIDE:
            self._keep(rows[:kept])
            progress.steps += step
            raise self._failure(step)
        last = rows[kept - 1] if progress.ticks % pace.every == 0 else rows[kept]
        progress.stiffest = max(progress.stiffest, last[STIFFEST] * pace.h)
        self._keep(rows[:kept])
        if progress.ticks % pace.frames_every == 0:
            self._frame()
        if status in (RESTING, REACHED):
            if progress.ticks % pace.every:
                self._keep(last[None])
            reason = "rest" if status == RESTING else "force"
            self._end_stage(reason, new_frame=progress.ticks % pace.frames_every != 0)
        elif status == LEFT:
            self._let_go()
        elif status == STIFF:
            self._set_steps(self.seen[1])
        elif progress.ticks % REVIEW == 0:
            if self.step.automatic and self._dissipates:
                self._set_steps(self.seen[0])
            self.seen[0] = 0.0

    @property
    def _dissipates(self) -> bool:
        acting = self.constants.acting
        return acting.drag is not None or acting.friction is not None

    def _let_go(self) -> None:
        """Take out the grains that have left through the gap, with the energy they carry."""
        before = self._energy(self._look())
        grains, state = self.constants.grains, self.state
        for i in range(grains - 1, -1, -1):
            if state.y[i] < self.constants.exit:
                grains -= 1
                self._move_last_to(i, grains)
        self.constants = self.constants._replace(grains=grains)
        state.push[:] = 0.0
        if state.shove is not None:
            state.shove[:] = 0.0
        after = self._energy(self._look())
        state.ledger[WORK] += after - before

    def _move_last_to(self, i: int, last: int) -> None:
        """Fill the place of a grain with the last one's values, and put the padding there."""
        state = self.state
        moving = (state.x, state.y, state.vx, state.vy, state.label, *self._grain_constants())
        for values in moving:
            values[[i, last]] = values[[last, i]]
        state.x[last], state.y[last] = PADDING * (last + 1.0), 0.0
        state.vx[last] = state.vy[last] = 0.0

    def _set_steps(self, frequency: float) -> None:
        steps = self.step.steps_of(self.pace.length, frequency)
        self.progress.pace = {**self.progress.pace, "steps": steps}

    def _short_tick(self, left: float) -> None:
        """The rest of a stage that is no whole tick, in steps that are a little shorter."""
        progress, pace = self.progress, self.pace
        steps = max(1, math.ceil(left / pace.h - 1e-6))
        rows = np.empty((2, len(COLUMNS)))
        watch = self._watch()._replace(rest=-1.0, stiff=math.inf)
        status, _, _, step = advance(
            1, progress.ticks, pace.length, steps, left / steps, progress.start, 1,
            self.kicks, self.drifts, self.state, self.constants, self.motion,
            self.measurement, watch, rows,
        )  # fmt: skip
        progress.steps += step if status == OUTSIDE else steps
        if status == OUTSIDE:
            raise self._failure(step)
        self._keep(rows[:1])

    def run_tail(self) -> float:
        """Run the part of a tick before ``t_end`` and take a last frame; the time reached [tau].

        A snapshot to resume from is taken before this.
        """
        if self.finished or not self.progress.begun:
            return self.progress.start
        left = self.t_end - self.time
        if left > 1e-6 * self.pace.h:
            self._short_tick(left)
            self._frame(self.t_end)
            return self.t_end
        if self.progress.ticks % self.pace.frames_every:
            self._frame()
        return self.time

    def _end_stage(self, reason: str, *, new_frame: bool) -> None:
        progress, stage = self.progress, self._stage
        if reason == "duration" and isinstance(stage, Timed) and stage.until == "rest":
            raise self._not_at_rest(stage)
        end = progress.last
        final = stage.final_height()
        if final is not None:
            self.state.piston[0] = final / self.system.scales.length
        height, spread = float(self.state.piston[0]), 0.0
        if reason == "rest":
            height = 0.5 * (self.band[1] + self.band[2])
            spread = self.band[2] - self.band[1]
        if new_frame:
            self._frame(end)
        progress.results.append(self._result(reason, end, height, spread))
        progress.start = end
        progress.stage += 1
        progress.begun = False
        progress.ticks = 0
        progress.pace = {}

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
        cut = self._result("cut", until, float(self.state.piston[0]), 0.0)
        return [*self.progress.results, cut]

    # Records and failures ----------------------------------------------------------------------

    def _keep(self, rows: np.ndarray) -> None:
        if not len(rows):
            return
        assert self.ledger is not None
        bad = self.ledger.check(rows)
        self.progress.closest = min(self.progress.closest, float(rows[:, CLOSEST].min()))
        self.progress.last = float(rows[-1, 0])
        self.recorder.add_rows(rows if bad is None else rows[: bad + 1], self.progress.stage)
        if bad is not None:
            raise self._energy_failure(rows[bad])

    def _frame(self, at: float | None = None) -> None:
        moment = self.time if at is None else at
        self.recorder.add_frame(moment, self.state, self.constants)

    def _where(self, step: int) -> tuple[int, float]:
        pace = self.progress.pace
        h = self.pace.h if pace else 0.0
        return self.progress.steps, (self.time + step * h) * self.system.scales.time

    def _failure(self, step: int) -> RunError:
        count, scales = self.constants.grains, self.system.scales
        steps, moment = self._where(step)
        place = np.stack([self.state.x[:count], self.state.y[:count]], axis=1)
        lost = ~np.isfinite(place).all(axis=1)
        remedy = "shorten dt (or leave it 'auto')"
        if lost.any():
            grain = int(np.argmax(lost))
            return NotFiniteError(
                "the position is not finite any more",
                step=steps, time=moment, grain=grain, remedy=remedy,
            )  # fmt: skip
        walls = self.constants.acting.walls
        height = self.state.piston[0]
        gaps = {
            "the left wall": (walls.left, place[:, 0]),
            "the right wall": (walls.right, self.constants.width - place[:, 0]),
            "the bottom": (walls.bottom, place[:, 1]),
            "the piston": (walls.top, height - place[:, 1]),
        }
        for name, (law, gap) in gaps.items():
            if law is not None and len(gap) and not gap.min() > 0.0:
                grain = int(gap.argmin())
                value = -float(gap[grain]) * scales.length
                return OutsideError(
                    f"the grain is {value:.3g} m behind {name}, 0 m is the limit",
                    step=steps, time=moment, grain=grain, value=value, remedy=remedy,
                )  # fmt: skip
        return NotFiniteError(
            "a force is not finite any more", step=steps, time=moment, remedy=remedy
        )

    def _energy_failure(self, row: np.ndarray) -> EnergyError:
        assert self.ledger is not None
        return EnergyError(
            f"the energy ledger is off by {self.ledger.closure:.2g} of the energy turned over, "
            f"{self.ledger.wrong:g} is the limit",
            step=self.progress.steps,
            time=float(row[0]) * self.system.scales.time,
            value=self.ledger.closure,
            remedy="shorten dt (or leave it 'auto')",
        )

    def _not_at_rest(self, stage: Timed) -> NotAtRestError:
        steps, moment = self._where(0)
        value = float(self.band[2] - self.band[1]) * self.system.scales.length
        return NotAtRestError(
            f"stage {stage.name!r} did not come to rest within {stage.span(0.0):g} s; the piston "
            f"still ranges over {value:.3g} m",
            step=steps,
            time=moment,
            value=value,
            remedy="give the stage a longer duration, a greater tolerance or more dissipation",
        )

    def expected_seconds(self) -> float | None:
        """Length of the present stage [s], as far as it is known."""
        stage = self._stage
        if isinstance(stage, Timed) and stage.until == "rest":
            return None
        end = min(self.total, self.t_end - self.progress.start)
        return end * self.system.scales.time if math.isfinite(end) else None
