"""A progress bar on standard error, and before it a word on a run that will take long."""

from __future__ import annotations

import time
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from granular.kernel_data.state import HEIGHT
from granular.run.outlook import outlook, stage_seconds, steps_ahead
from granular.run.settling import Settling
from granular.run.watch import rest_limit
from granular.shared.progress import progress_bar, say

if TYPE_CHECKING:
    from granular.run.run import Run


JUDGED = 0.5
"""For so long [s] the steps are counted before: the first call, which compiles, does not count."""


class ProgressBar:
    """One line that shows the stage, its time and the piston while a run goes on."""

    def __init__(self, wanted: bool) -> None:
        self.wanted = wanted
        self._bar: Any = None
        self._settling: Settling | None = None
        self._stage = -1
        self._first: tuple[float, int] | None = None
        self._told = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.close()

    def show(self, run: Run) -> None:
        """Show how far the run is."""
        if not self.wanted:
            return
        progress = run.progress
        self._tell(run)
        if self._stage != progress.stage:
            if self._bar is not None:
                self._bar.close()
                self._bar = None
            self._stage = progress.stage
            if run.finished:
                return
            self._bar, self._settling = self._of_stage(run)
        if self._bar is None:
            return
        words = ""
        if run.scene.piston is not None:
            words = f", piston at {run.state.piston[HEIGHT]:.3f} D"
        reached = (run.time - progress.start) * run.system.scales.time
        if self._settling is not None:
            self._settling.look(run)
            reached, words = self._settling.share, f"{reached:.2f} s, {self._settling}{words}"
        self._bar.set_postfix_str(words.removeprefix(", "), refresh=False)
        if self._bar.total is not None:
            reached = min(reached, self._bar.total)
        self._bar.update(reached - self._bar.n)

    def _of_stage(self, run: Run) -> tuple[Any, Settling | None]:
        """A bar of the stage's time; of one that ends at rest, of the way to rest."""
        name = f"{run.scene.name}: {run.stage.name}"
        if rest_limit(run) >= 0.0:
            form = "{desc} {bar:20}{postfix} [{elapsed}]"
            return progress_bar(desc=name, total=1.0, bar_format=form), Settling(run)
        form = "{desc} {bar:20} {n:.2f} s{postfix} [{elapsed}<{remaining}]"
        return progress_bar(desc=name, total=stage_seconds(run), bar_format=form), None

    def _tell(self, run: Run) -> None:
        """Say once how many steps are ahead, and how long they take, if that is long."""
        now = time.perf_counter()
        if self._first is None:
            self._first = now, run.steps
        begun, made = self._first
        if self._told or now - begun < JUDGED or run.steps == made:
            return
        self._told = True
        words = outlook(steps_ahead(run), (run.steps - made) / (now - begun))
        if words is not None:
            say(f"{run.scene.name}: {words}")
