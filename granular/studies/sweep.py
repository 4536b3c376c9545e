"""`sweep`: run many variations of one scene, each case once, on this machine or a cluster.

A study file has this form:

    scene = "damper"               # a packaged scene, or a path relative to this file
    measure = "last-values"        # or the name of a user-defined measure
    dt = "auto*2"                  # as in simulate; t_end and method likewise

    [changes]                      # in every case
    "grains.count" = 92

    [grid]                         # all combinations
    "piston.mass" = [2.0, 3.0]
    "arrangement.seed" = [1, 2, 3]

    [[cases]]                      # further individual cases
    "piston.mass" = "4 kg"
    dt = "auto"                    # dt, t_end and method may differ between cases
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import dataclasses
import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, Self, TypeVar

from granular.methods import Method
from granular.run.dataset import scalar_variables
from granular.scene.named_scenes import load_scene, scene_names
from granular.scene.scene import Scene
from granular.schema.field_kinds import IntegerKind, QuantityKind
from granular.schema.sections import find_field_value_and_kind
from granular.shared.errors import InputError, StoreError, sanitize, unknown_word_message
from granular.shared.files import make_directory, read_toml
from granular.shared.progress_bars import progress_bar
from granular.studies.cases import (
    ELSEWHERE,
    MACHINE,
    PROGRAM,
    Case,
    CaseOutcome,
    Measure,
    OutcomeCache,
    find_measure,
    last_values,
    make_cases,
)
from granular.studies.executors import (
    ProcessPool,
    given_executor_or_new_processes,
    read_or_compute_case_outcome,
)

if TYPE_CHECKING:
    import pandas


ATTEMPTS = 3
"""Number of workers that may die during a case before the case counts as failed. A single worker may have
been killed externally, but three deaths are attributed to the case."""


@dataclasses.dataclass(frozen=True)
class Study:
    """The cases and outcomes of a sweep.

    Attributes
    ----------
    cases : tuple of Case
        One or more cases, the cases of the grid first.
    outcomes : tuple of CaseOutcome
        Results, error and warning of each case, in the order of the cases.
    reused : int
        Number of cases that had already been computed.
    """

    cases: tuple[Case, ...]
    outcomes: tuple[CaseOutcome, ...]
    reused: int

    @property
    def table(self) -> pandas.DataFrame:
        """DataFrame with a row for each case: changes and results in SI units, warning, error and key.

        Results that a case lacks, for example because it failed, are NaN. ``table.attrs["units"]`` holds the
        units of columns that have a unit.
        """
        import pandas

        rows = [
            _varied_values_in_si(case, self.varied)
            | dict(outcome.figures)
            | ({} if outcome.warning is None else {"warning": outcome.warning})
            | {"error": outcome.error, "key": case.key}
            for case, outcome in zip(self.cases, self.outcomes, strict=True)
        ]
        table = pandas.DataFrame(rows)
        last = [name for name in ("warning", "error", "key") if name in table]
        table = table[[name for name in table.columns if name not in last] + last]
        table.attrs["units"] = {name: self.units[name] for name in table.columns if name in self.units}
        return table

    @property
    def varied(self) -> tuple[str, ...]:
        """Tuple of the distinct dotted keys and settings that the cases change."""
        return tuple(dict.fromkeys(key for case in self.cases for key in case.changes))

    @property
    def units(self) -> dict[str, str]:
        """SI units by name: of changed and recorded quantities, and of end times and heights of stages.

        Dimensionless quantities and other results of user-defined measures are omitted.
        """
        scene = self.cases[0].scene
        units = {variable.name: variable.unit for variable in scalar_variables(scene)}
        for stage in scene.protocol:
            units |= {f"{stage.name}.end": "s", f"{stage.name}.height": "m"}
        for case in self.cases:
            for key in case.changes:
                field = find_field_value_and_kind(case.scene, key)
                if field is not None and isinstance(field[1], QuantityKind):
                    units[key] = field[1].unit
        return {name: unit for name, unit in units.items() if unit != "1"}

    @property
    def failed(self) -> tuple[Case, ...]:
        """Cases that failed, because of the physics or of the machine, as a tuple of `Case`."""
        pairs = zip(self.cases, self.outcomes, strict=True)
        return tuple(case for case, outcome in pairs if outcome.error is not None)

    @property
    def unfinished(self) -> tuple[Case, ...]:
        """Cases that failed for reasons other than the physics, as a tuple; the next sweep retries them."""
        pairs = zip(self.cases, self.outcomes, strict=True)
        return tuple(case for case, outcome in pairs if outcome.cause is not None)

    def to_csv(self) -> str:
        """Return the table as text, with the units in its header.

        Returns
        -------
        str
            The `table` as comma-separated values. Column names include units, such as ``piston.mass [kg]``;
            NaN becomes an empty cell.
        """
        table = self.table
        units = table.attrs["units"]
        names = {name: f"{name} [{unit}]" for name, unit in units.items()}
        return str(table.rename(columns=names).to_csv(index=False))


def _varied_values_in_si(case: Case, keys: Sequence[str]) -> dict[str, Any]:
    """Return the values of all varied keys in a case, with quantities as numbers in SI."""
    result = {}
    for key in keys:
        field = find_field_value_and_kind(case.scene, key)
        quantity = field is not None and isinstance(field[1], QuantityKind | IntegerKind)
        if field is not None and (quantity or key not in case.changes):
            result[key] = field[0]
        else:
            result[key] = case.changes.get(key, case.settings.get(key))
    return result


def sweep(
    scene: Scene,
    grid: Mapping[str, Iterable[Any]] | None = None,
    *,
    cases: Sequence[Mapping[str, Any]] = (),
    measure: Measure = last_values,
    dt: float | str = "auto",
    t_end: float | None = None,
    method: str | Method | Mapping[str, Any] = "stormer-verlet",
    out: str | Path | None = None,
    keep_runs: bool = False,
    executor: Executor | None = None,
    workers: int | None = None,
    progress: bool = True,
    title: str = "cases",
) -> Study:
    """Run many variations of a scene.

    Parameters
    ----------
    scene : Scene
        Scene to be varied.
    grid : mapping of str to values
        Lists of values by dotted key; all combinations are run. The keys ``dt``, ``t_end`` and ``method`` are
        allowed as well and override the arguments.
    cases : sequence of mapping
        Changes of further individual cases.
    measure : function of Trajectory
        Function that returns the results of a run to be stored, as numbers by name. It must be transferable
        to other processes.
    dt : float or str
        Time step [s] of cases that do not set one, as in `simulate`.
    t_end : float, optional
        End time [s] of cases that do not set one.
    method : str, Method or mapping
        Integration method of cases that do not set one.
    out : str or Path, optional
        Directory in which each outcome is stored as soon as it is available. A repeated call continues the
        sweep: a case with the same scene, settings and measure is not computed twice, not even by two
        simultaneous sweeps on one directory. Errors due to the physics are stored. Cases that failed because
        of the machine, for example because of a full disk, are retried in this call and in the next one.
    keep_runs : bool
        Keep the complete runs in ``out`` too; an interrupted case then resumes from its last checkpoint.
    executor : concurrent.futures.Executor, optional
        Executor that computes the cases, such as a Dask client's ``get_executor()`` or an MPIPoolExecutor. It
        is not shut down. If not given, processes on this machine compute the cases.
    workers : int, optional
        Number of processes, 1 or more; by default the number of processors. Each run uses one thread.
    progress : bool
        Show a progress bar on standard error.
    title : str
        Title of the progress bar.

    Returns
    -------
    Study
        All cases. In the table, the row of a failed case gives the error.

    Raises
    ------
    InputError
        If the study has no cases, two cases are equal, a change, time step or method is invalid, ``workers``
        is below 1, ``keep_runs`` is set without ``out``, or ``out`` cannot be created.
    ExecutorLostError
        If the scheduler of a cluster is lost; finished cases remain in ``out``.
    KeyboardInterrupt
        On Ctrl-C; finished cases remain in ``out``.

    Warns
    -----
    UserWarning
        Once, if cases raised warnings: the number of warnings and the text of the first one. The table
        contains all of them.
    """
    if keep_runs and out is None:
        raise InputError("keep_runs = True needs out, a directory for the runs")
    if workers is not None and workers < 1:
        raise InputError(f"workers = {workers}; 1 process or more is needed")
    settings = {"dt": dt, "t_end": t_end, "method": method}
    all_cases = make_cases(scene, grid or {}, cases, settings, measure)
    directory = None if out is None else Path(out).absolute()
    if directory is not None:
        make_directory(OutcomeCache(directory).files.directory)
    done = _read_stored_outcomes(all_cases, directory)
    reused = len(done)
    waiting = [case for case in all_cases if case.key not in done]
    with (
        given_executor_or_new_processes(executor, min(len(waiting), workers or os.cpu_count() or 1)) as pool,
        progress_bar(
            wanted=progress, total=len(all_cases), initial=reused, desc=title, unit="case", smoothing=0.1
        ) as bar,
    ):
        failed = 0
        for case, outcome in compute_outcomes_with_retries(waiting, measure, directory, keep_runs, pool):
            done[case.key] = outcome
            failed += outcome.error is not None
            if failed:
                bar.set_postfix_str(f"{failed} failed", refresh=False)
            bar.update()
    study = Study(tuple(all_cases), tuple(done[case.key] for case in all_cases), reused)
    _warn_of_cases_with_warnings(study)
    return study


def _warn_of_cases_with_warnings(study: Study) -> None:
    pairs = zip(study.cases, study.outcomes, strict=True)
    with_warnings = [(case, outcome.warning) for case, outcome in pairs if outcome.warning is not None]
    if with_warnings:
        case, message = with_warnings[0]
        changes = ", ".join(f"{key} = {value}" for key, value in case.changes.items())
        warnings.warn(
            f"{len(with_warnings)} of {len(study.cases)} cases raised warnings (see the table), the first "
            f"({sanitize(changes)}): {message}",
            stacklevel=3,
        )


def _read_stored_outcomes(cases: Sequence[Case], directory: Path | None) -> dict[str, CaseOutcome]:
    if directory is None:
        return {}
    cache = OutcomeCache(directory)
    result = {case.key: cache.read(case.key) for case in cases}
    return {key: outcome for key, outcome in result.items() if outcome is not None}


def compute_outcomes_with_retries(
    cases: Sequence[Case], measure: Measure, directory: Path | None, keep_runs: bool, pool: Executor
) -> Iterator[tuple[Case, CaseOutcome]]:
    """Compute cases as workers become free, and retry cases that failed because of the machine."""
    waiting = {case.key: case for case in cases}
    deaths, single_batches = 0, 0
    retried: dict[str, set[str]] = {MACHINE: set(), ELSEWHERE: set()}
    unstored: list[tuple[Case, CaseOutcome]] = []
    while waiting:
        batch = list(waiting.values())[: 1 if single_batches else None]
        lost = {case.key for case in batch}
        submitted = [(case, case.key in retried[ELSEWHERE]) for case in batch]
        for case, outcome in _compute_cases(submitted, measure, directory, keep_runs, pool):
            lost.discard(case.key)
            cause = outcome.cause
            if cause in retried and case.key not in retried[cause]:
                retried[cause].add(case.key)
                waiting[case.key] = waiting.pop(case.key)
                continue
            del waiting[case.key]
            if cause is None and _store_outcome(case, outcome, directory).cause is not None:
                unstored.append((case, outcome))
                continue
            yield case, outcome
        single_batches = max(0, single_batches - 1)
        if not lost:
            continue
        deaths += 1
        if deaths >= ATTEMPTS and len(batch) == 1:
            del waiting[batch[0].key]
            yield batch[0], CaseOutcome(error=f"the worker died {ATTEMPTS} times", cause=MACHINE)
            deaths, single_batches = 0, 0
        # A worker that dies loses its other cases too. The next cases, one of which was running at that time,
        # are therefore tried one at a time, so that a further death is attributable to one case.
        elif deaths >= ATTEMPTS - 1:
            single_batches = 2 * (os.cpu_count() or 1)
    for case, outcome in unstored:
        yield case, _store_outcome(case, outcome, directory)


def _compute_cases(
    cases: Sequence[tuple[Case, bool]],
    measure: Measure,
    directory: Path | None,
    keep_runs: bool,
    pool: Executor,
) -> Iterator[tuple[Case, CaseOutcome]]:
    """Yield cases with their outcomes; a case marked True is awaited if another sweep computes it."""
    futures: dict[Future[CaseOutcome], Case] = {}
    try:
        with contextlib.suppress(concurrent.futures.BrokenExecutor):
            for case, wait in cases:
                futures[
                    pool.submit(read_or_compute_case_outcome, case, measure, directory, keep_runs, wait)
                ] = case
        for future in concurrent.futures.as_completed(futures):
            outcome = outcome_of_future(future)
            if outcome is not None:
                yield futures[future], outcome
    finally:
        # Local processes end with all their tasks; loky fails on tasks that were cancelled before.
        if not isinstance(pool, ProcessPool):
            for future in futures:
                future.cancel()


def _store_outcome(case: Case, outcome: CaseOutcome, directory: Path | None) -> CaseOutcome:
    """Store an outcome that its worker could not store, for example on a full disk; return the outcome."""
    if directory is None:
        return outcome
    cache = OutcomeCache(directory)
    try:
        if cache.read(case.key, warn=False) is None:  # damaged files have already been reported
            cache.store(case.key, outcome)
    except StoreError as error:
        return dataclasses.replace(outcome, error=f"{type(error).__name__}: {error}", cause=MACHINE)
    return outcome


def outcome_of_future(future: Future[CaseOutcome]) -> CaseOutcome | None:
    """Return the outcome that a worker has returned, or None if the worker has died."""
    try:
        return future.result()
    except (concurrent.futures.BrokenExecutor, concurrent.futures.CancelledError):
        return None
    except Exception as error:
        if type(error).__name__ == "KilledWorker":  # an error of Dask, which is imported only if used
            return None
        return CaseOutcome(error=f"{type(error).__name__}: {error}", cause=PROGRAM)


KEYS = ("scene", "measure", "dt", "t_end", "method", "changes", "grid", "cases")


def load_study(path: str | Path, user_measures: Mapping[str, Measure] | None = None) -> dict[str, Any]:
    """Read the TOML file of a study into the arguments of `sweep`."""
    path = Path(path)
    plain = read_toml(path)
    for key in plain:
        if key not in KEYS:
            raise InputError(f"{path.name}: {unknown_word_message(key, KEYS, 'key')}")
    if "scene" not in plain:
        raise InputError(f"{path.name}: the key 'scene' is missing; add a packaged scene or a path")
    for key, kind in (("changes", dict), ("grid", dict), ("cases", list)):
        if not isinstance(plain.get(key, kind()), kind):
            raise InputError(f"{path.name}: {key} must be a {'table' if kind is dict else 'list'}")
    name = str(plain["scene"])
    scene = load_scene(name if name in scene_names() else path.parent / name)
    result: dict[str, Any] = {key: plain[key] for key in ("dt", "t_end", "method", "cases") if key in plain}
    result["grid"] = _flatten_keys(plain.get("grid", {}))
    result["cases"] = [_flatten_keys(case) for case in plain.get("cases", [])]
    result["measure"] = find_measure(str(plain.get("measure", "last-values")), user_measures)
    result["scene"] = scene.replace(**_flatten_keys(plain.get("changes", {})))
    return result


def _flatten_keys(changes: dict[str, Any], above: str = "") -> dict[str, Any]:
    """Convert nested tables to dotted keys, because TOML reads piston.mass = 1 as a nested table."""
    flat: dict[str, Any] = {}
    for key, value in changes.items():
        name = f"{above}.{key}" if above else key
        nested = isinstance(value, dict) and name != "method"  # a method may be given as a table
        flat |= _flatten_keys(value, name) if nested else {name: value}
    return flat


T = TypeVar("T")


class BackgroundCase(NamedTuple):
    """Case submitted to an executor, with its future outcome."""

    case: Case
    future: Future[CaseOutcome]


@dataclasses.dataclass(frozen=True)
class BackgroundCall(Generic[T]):
    """Call submitted to a process; if ``future`` is None, the caller of `result` computes it."""

    future: Future[T] | None
    function: Callable[..., T]
    args: tuple[Any, ...]

    def result(self) -> T:
        """Wait for the result, or compute it here if the call has not started or its process has died."""
        if self.future is not None and not self.future.cancel():
            with contextlib.suppress(BrokenExecutor):
                return self.future.result()
        return self.function(*self.args)


class BackgroundCaseRunner:
    """Runs cases in the background; cases that are not finished at the end are cancelled."""

    def __init__(self, measure: Measure, executor: Executor | None) -> None:
        self._measure, self._own = measure, executor is None
        # One processor is reserved for the caller.
        self._pool = executor or ProcessPool(max(1, (os.cpu_count() or 1) - 1))
        self._started: list[BackgroundCase] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._own:
            self._pool.shutdown(wait=False, cancel_futures=True)
            return
        for started in self._started:
            started.future.cancel()

    def submit_cases(
        self, scene: Scene, changes: Sequence[Mapping[str, Any]], settings: Mapping[str, Any]
    ) -> list[BackgroundCase]:
        """Submit cases to the executor without waiting for them."""
        started = []
        for case in make_cases(scene, {}, changes, settings, self._measure) if changes else ():
            try:
                future = self._pool.submit(
                    read_or_compute_case_outcome, case, self._measure, None, False, True
                )
            except BrokenExecutor as error:  # retried by the caller that waits
                future = Future()
                future.set_exception(error)
            started.append(BackgroundCase(case, future))
        self._started += started
        return started

    def submit_call(
        self, function: Callable[..., T], *args: Any, in_caller: bool = False
    ) -> BackgroundCall[T]:
        """Submit a call to processes of this machine; the user's executor computes only cases."""
        future: Future[T] | None = None
        if self._own and not in_caller:
            with contextlib.suppress(BrokenExecutor):  # computed by the caller that requests the result
                future = self._pool.submit(function, *args)
        return BackgroundCall(future, function, args)

    def wait_for_outcomes(
        self, started: Sequence[BackgroundCase], title: str, progress: bool
    ) -> list[CaseOutcome]:
        """Wait for cases, and compute here those that have not started; retry cases whose process died."""
        waiting = {entry.future for entry in started}
        done = {future for future in waiting if future.done()}
        outcomes: dict[str, CaseOutcome] = {}
        with progress_bar(
            wanted=progress, total=len(started), initial=len(done), desc=title, unit="run"
        ) as bar:
            for entry in reversed(started):
                if self._own and entry.future.cancel():
                    outcomes[entry.case.key] = read_or_compute_case_outcome(
                        entry.case, self._measure, None, False
                    )
                    waiting.remove(entry.future)
                    bar.update()
            for _ in concurrent.futures.as_completed(waiting - done):
                bar.update()
        for entry in started:
            if entry.future in waiting and (outcome := outcome_of_future(entry.future)) is not None:
                outcomes[entry.case.key] = outcome
        lost = [entry.case for entry in started if entry.case.key not in outcomes]
        for case, outcome in compute_outcomes_with_retries(lost, self._measure, None, False, self._pool):
            outcomes[case.key] = outcome
        return [outcomes[entry.case.key] for entry in started]
