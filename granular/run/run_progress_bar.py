"""Progress bar of a run on standard error, which also announces the duration of long runs."""

from __future__ import annotations

import contextlib
import math
import time
from collections import deque
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from granular.compiled.numba_insides import report_compiled_kernels
from granular.kernel_data.state import HEIGHT, SPEED
from granular.protocol.stage import TimedStage
from granular.shared.progress_bars import print_above_bar, progress_bar

if TYPE_CHECKING:
    from granular.run.protocol_runner import ProtocolRunner

MEASURED_SECONDS = 0.5
"""Time [s] after compilation in which steps are counted, to estimate the duration of the run."""

ANNOUNCED_SECONDS = 60.0
"""Wall-clock duration of a run [s] above which it is announced at the start."""


class RunProgressBar:
    """Line on the terminal that shows stage, time and piston height during a run."""

    def __init__(self, visible: bool) -> None:
        self.visible = visible
        self._bar: Any = None
        self._compiling: Any = None
        self._reports = contextlib.ExitStack()
        self._settling: ApproachToRest | None = None
        self._stage = -1
        self._first: tuple[float, int] | None = None
        self._announced = False

    def __enter__(self) -> Self:
        if self.visible:
            self._reports.enter_context(report_compiled_kernels(self._show_compiled_kernels))
        return self

    def __exit__(self, *_: object) -> None:
        self._reports.close()
        for bar in (self._compiling, self._bar):
            if bar is not None:
                bar.close()

    def _show_compiled_kernels(self, kernels: int) -> None:
        """Show that kernels are compiled before the first steps."""
        if self._compiling is None:
            words = "compiling for this type of scene, cached for later runs"
            form = "{desc}{postfix} [{elapsed}]"
            self._compiling = progress_bar(desc=words, bar_format=form)
        self._compiling.set_postfix_str(f"kernel {kernels}")

    def show(self, run: ProtocolRunner) -> None:
        """Show the present stage, time and piston height."""
        if not self.visible:
            return
        if self._compiling is not None:
            self._compiling.close()
            self._compiling = None
        progress = run.progress
        self._announce_remaining_steps(run)
        if self._stage != progress.stage:
            if self._bar is not None:
                self._bar.close()
            self._stage, self._bar = progress.stage, None
            if not run.is_protocol_finished:
                self._bar, self._settling = self._new_stage_bar(run)
        if self._bar is None:
            return
        words = ""
        if run.scene.piston is not None:
            words = f", piston at {run.state.piston[HEIGHT]:.3f} D"
        reached = (run.present_time - progress.start) * run.system.scales.time
        if self._settling is not None:
            self._settling.update(run)
            reached, words = self._settling.fraction, f"{reached:.2f} s, {self._settling}{words}"
        self._bar.set_postfix_str(words.removeprefix(", "), refresh=False)
        if self._bar.total is not None:
            reached = min(reached, self._bar.total)
        self._bar.update(reached - self._bar.n)

    def _new_stage_bar(self, run: ProtocolRunner) -> tuple[Any, ApproachToRest | None]:
        """Make a bar for the stage's time; for a stage that ends at rest also return the `ApproachToRest`."""
        name = f"{run.scene.name}: {run.stage.name}"
        if run.rest_tolerance >= 0.0:
            form = "{desc} {bar:20}{postfix} [{elapsed}]"
            return progress_bar(desc=name, total=1.0, bar_format=form), ApproachToRest(run)
        form = "{desc} {bar:20} {n:.2f} s{postfix} [{elapsed}<{remaining}]"
        seconds = min(run.stage_duration, run.t_end - run.progress.start) * run.system.scales.time
        total = seconds if math.isfinite(seconds) else None
        return progress_bar(desc=name, total=total, bar_format=form), None

    def _announce_remaining_steps(self, run: ProtocolRunner) -> None:
        """Announce the number and duration of the remaining steps once, if the duration is long."""
        now = time.perf_counter()
        started, made = self._first = self._first or (now, run.step_count)
        if self._announced or now - started < MEASURED_SECONDS or run.step_count == made:
            return
        self._announced = True
        words = remaining_time_text(
            estimate_remaining_step_count(run), (run.step_count - made) / (now - started)
        )
        if words is not None:
            print_above_bar(f"{run.scene.name}: {words}")


class ApproachToRest:
    """Present range of motion, compared with the limit below which the bed counts as at rest."""

    def __init__(self, run: ProtocolRunner) -> None:
        stage = run.stage
        assert isinstance(stage, TimedStage)
        self.limit = run.rest_tolerance
        self.amplitude, self.fraction = math.inf, 0.0
        self._window = stage.window / run.system.scales.time
        self._seen: deque[tuple[float, float, float]] = deque()
        self._largest_amplitude = 0.0

    def update(self, run: ProtocolRunner) -> None:
        """Add the present height and speeds."""
        state = run.state
        fastest = float(np.hypot(state.vx, state.vy).max(initial=abs(float(state.piston[SPEED]))))
        self._seen.append((run.present_time, float(state.piston[HEIGHT]), fastest))
        while self._seen[0][0] < run.present_time - self._window:
            self._seen.popleft()
        heights = [height for _, height, _ in self._seen]
        height_range = max(heights) - min(heights)
        self.amplitude = max(height_range, *(speed for _, _, speed in self._seen), 0.0)
        self._largest_amplitude = max(self._largest_amplitude, self.amplitude)
        if self.amplitude <= self.limit:
            self.fraction = 1.0
        elif self._largest_amplitude > self.limit:
            decades = math.log(self._largest_amplitude / self.limit)
            self.fraction = math.log(self._largest_amplitude / self.amplitude) / decades

    def __str__(self) -> str:
        return f"moves {self.amplitude:.1e} D, at rest below {self.limit:.0e} D"


def estimate_remaining_step_count(run: ProtocolRunner) -> float:
    """Estimate the number of steps to the end of a run from the present time step."""
    progress, last = run.progress, run.scene.protocol[-1]
    if run.is_protocol_finished or not progress.started:
        return 0.0
    later = run.scene.protocol[progress.stage + 1 :]
    # Stages that end at rest or at a force count with their maximum duration. Durations of later stages are
    # estimated from the present height.
    durations = [stage.maximum_duration(progress.height) or 0.0 for stage in later]
    end = min(progress.start + run.stage_duration + math.fsum(durations) / run.system.scales.time, run.t_end)
    if isinstance(last, TimedStage) and last.until is None and math.isfinite(run.t_end):
        end = run.t_end  # a timed last stage extends to t_end
    return max(0.0, end - run.present_time) / run.schedule.h


def remaining_time_text(steps: float, rate: float) -> str | None:
    """Describe how long a number of steps takes at a rate [1/s], or return None if the time is short."""
    seconds = steps / rate
    if seconds < ANNOUNCED_SECONDS:
        return None
    sizes = (("years", 3.156e7), ("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0))
    unit, size = next(size for size in sizes if seconds >= size[1])
    return f"up to {steps:.2g} steps, {seconds / size:.2g} {unit} at {rate:.2g} steps a second"
