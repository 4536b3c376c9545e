"""Runs of a plan's series by `granular.sweep`, which stores each finished case even if it is killed later."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from granular import sweep
from granular.run.plan import parse_time_step
from granular.scene.named_scenes import load_scene
from granular.scene.scene import Scene
from granular.shared.files import ResultCache
from granular.studies.cases import CaseOutcome, OutcomeCache, make_cases
from research.published.plan import SeriesGroup
from research.published.series import Series

METHOD = "stormer-verlet"


def run_groups(
    groups: Sequence[SeriesGroup],
    directory: Path,
    *,
    executor: Executor | None = None,
    workers: int | None = None,
    progress: bool = True,
    after: Callable[[], None] = lambda: None,
) -> None:
    """Run all groups, in their order.

    Parameters
    ----------
    groups : sequence of Group
    directory : Path
        Directory that stores every outcome as soon as it is available.
    executor, workers
        As in `granular.sweep`.
    progress : bool
        Show groups, cases and the remaining time on standard error.
    after : callable
        Called after each group.
    """
    clock = _RemainingTimeEstimate(groups, directory, workers or 1)
    for index, group in enumerate(groups):
        if not group.series:
            continue
        if progress:
            print(clock.next_group_and_time_text(index), file=sys.stderr, flush=True)
        for measure in dict.fromkeys(item.measure for item in group.series):
            sweep(
                load_scene("bed"),
                cases=_distinct_cases_of_starts(item for item in group.series if item.measure is measure),
                measure=measure,
                method=METHOD,
                out=directory,
                keep_runs=True,
                executor=executor,
                workers=workers,
                progress=progress,
            )
        _delete_finished_runs(directory)
        after()


def _delete_finished_runs(directory: Path) -> None:
    """Delete the runs whose outcome is cached: they were needed only to resume an interrupted sweep."""
    files = OutcomeCache(directory).files
    for run in (directory / "runs").glob("*"):
        if files.path(run.name).exists():
            shutil.rmtree(run, ignore_errors=True)


def cached_outcomes_of_series(series: Series, directory: Path) -> list[CaseOutcome]:
    """Return the cached outcomes of the starts of a series, without starts not yet run."""
    result = cached_outcomes_by_key(case_keys_of_starts(series), directory)
    return [item for item in result if item is not None]


def cached_outcomes_by_key(keys: Sequence[str], directory: Path) -> list[CaseOutcome | None]:
    """Return the outcome cached under each key, or None."""
    cache = OutcomeCache(directory)
    return [cache.read(key) for key in keys]


def reference_cache(directory: Path) -> ResultCache:
    """Return the cache of reference runs, keyed by the first start."""
    return ResultCache(directory / "references")


def delete_outcomes_and_reference(series: Series, directory: Path) -> None:
    """Delete outcomes and reference of a series whose code has changed."""
    files, keys = OutcomeCache(directory).files, case_keys_of_starts(series)
    for key in keys:
        files.path(key).unlink(missing_ok=True)
    reference_cache(directory).path(keys[0]).unlink(missing_ok=True)


def _distinct_cases_of_starts(series: Iterable[Series]) -> list[dict[str, Any]]:
    """Return the distinct cases of all starts."""
    cases = {}
    for item in series:
        for seed in item.seeds:
            scene = item.scene(seed)
            cases[scene.digest(), item.step] = scene.to_plain() | {"dt": item.step}
    return list(cases.values())


def case_keys_of_starts(series: Series) -> list[str]:
    """Return digests of scene, step and record type of each start."""
    settings = {"dt": series.step, "t_end": None, "method": METHOD}
    cases = make_cases(load_scene("bed"), {}, _distinct_cases_of_starts([series]), settings, series.measure)
    return [case.key for case in cases]


class _RemainingTimeEstimate:
    """Estimate of the remaining time of the groups, from the time of earlier groups."""

    def __init__(self, groups: Sequence[SeriesGroup], directory: Path, workers: int) -> None:
        self._groups, self._begun = groups, time.monotonic()
        self._costs = [
            sum(_remaining_pair_steps(item, directory) for item in group.series) for group in groups
        ]
        self._rate = _NOMINAL_RATE / workers

    def next_group_and_time_text(self, index: int) -> str:
        """Return the text on the next group, and the remaining time."""
        done, left = sum(self._costs[:index]), sum(self._costs[index:])
        if done > 0.0:
            self._rate = (time.monotonic() - self._begun) / done
        title = self._groups[index].title
        ahead = f"about {_duration_text(self._rate * left)} left"
        return f"group {index + 1} of {len(self._groups)}: {title}; {ahead}"


_NOMINAL_RATE = 5e-10
"""Processor time per pair of grains and step [s]."""
_AUTOMATIC_STEP = 4e-4
"""Approximate time step of a compressed bed [s]."""


def _remaining_pair_steps(series: Series, directory: Path) -> float:
    """Return the approximate pairs times steps of the starts of a series that were not run yet."""
    waiting = len(series.seeds) - len(cached_outcomes_of_series(series, directory))
    return waiting * _pairs_times_steps(series.scene(series.seeds[0]), series.step)


def _pairs_times_steps(scene: Scene, step: float | str) -> float:
    seconds, height = 0.0, scene.piston.height if scene.piston is not None else 0.0
    for stage in scene.protocol:
        total_duration = stage.maximum_duration(height)
        seconds += total_duration if total_duration is not None else 10.0
        height = stage.prescribed_final_height() or height
    asked = parse_time_step(step)
    length = asked.seconds or asked.factor * _AUTOMATIC_STEP
    return scene.grains.count**2 * seconds / length


def _duration_text(seconds: float) -> str:
    if seconds < 5400.0:
        return f"{max(1, round(seconds / 60.0))} min"
    return f"{seconds / 3600.0:.1f} h"
