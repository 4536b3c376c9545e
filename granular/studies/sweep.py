"""`sweep`: many changes of one scene, on any executor, each case once; a study as TOML.

scene = "damper"               # a packaged scene, or a path from here
measure = "last-values"        # or the name of a measure of one's own
dt = "auto*2"                  # as in simulate; t_end and method likewise

[changes]                      # in every case
"grains.count" = 92

[grid]                         # all combinations
"piston.mass" = [2.0, 3.0]
"arrangement.seed" = [1, 2, 3]

[[cases]]                      # and one by one
"piston.mass" = "4 kg"
dt = "auto"                    # dt, t_end and method may be a case's own
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
from granular.schema.sections import find_field
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
from granular.studies.executors import ProcessPool, case_executor, compute_case

if TYPE_CHECKING:
    import pandas


ATTEMPTS = 3
"""Workers that a case may lose before it is given up: one that dies may have been killed from
outside, one that dies thrice is killed by the case."""


@dataclasses.dataclass(frozen=True)
class Study:
    """The outcome of a sweep.

    Attributes
    ----------
    cases : tuple of Case
        Cases, those of the grid first; at least one.
    outcomes : tuple of CaseOutcome
        Figures, error and warning of each case, in the order of the cases.
    reused : int
        Number of cases that had been computed before.
    """

    cases: tuple[Case, ...]
    outcomes: tuple[CaseOutcome, ...]
    reused: int

    @property
    def table(self) -> pandas.DataFrame:
        """Row for each case: its changes and figures [SI], its warning and error, its key; a DataFrame.

        A figure that a case lacks, as a failed one, is NaN there. ``table.attrs["units"]`` holds the
        units of the columns that have one.
        """
        import pandas

        rows = [
            _si_changes(case, self.varied)
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
        """Dotted keys and settings that some case changes, each once, a tuple of str."""
        return tuple(dict.fromkeys(key for case in self.cases for key in case.changes))

    @property
    def units(self) -> dict[str, str]:
        """SI units by names, of changes and of figures that are records of a run or belong to its stages.

        What is without unit is left out, and so are other figures of an own measure.
        """
        scene = self.cases[0].scene
        units = {variable.name: variable.unit for variable in scalar_variables(scene)}
        for stage in scene.protocol:
            units |= {f"{stage.name}.end": "s", f"{stage.name}.height": "m"}
        for case in self.cases:
            for key in case.changes:
                field = find_field(case.scene, key)
                if field is not None and isinstance(field[1], QuantityKind):
                    units[key] = field[1].unit
        return {name: unit for name, unit in units.items() if unit != "1"}

    @property
    def failed(self) -> tuple[Case, ...]:
        """Cases that failed, by an error of the physics or of the machine, as a tuple of `Case`."""
        pairs = zip(self.cases, self.outcomes, strict=True)
        return tuple(case for case, outcome in pairs if outcome.error is not None)

    @property
    def unfinished(self) -> tuple[Case, ...]:
        """Cases that failed by no error of the physics, a tuple: the next sweep tries them again."""
        pairs = zip(self.cases, self.outcomes, strict=True)
        return tuple(case for case, outcome in pairs if outcome.cause is not None)

    def to_csv(self) -> str:
        """Return the table as text, with the units in its header.

        Returns
        -------
        str
            Comma-separated values of `table`; a name with a unit is ``piston.mass [kg]``, and NaN is empty.
        """
        table = self.table
        units = table.attrs["units"]
        names = {name: f"{name} [{unit}]" for name, unit in units.items()}
        return str(table.rename(columns=names).to_csv(index=False))


def _si_changes(case: Case, keys: Sequence[str]) -> dict[str, Any]:
    """Return a case's values of all that the study varies, quantities as numbers in SI."""
    result = {}
    for key in keys:
        field = find_field(case.scene, key)
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
    """Run a scene under many changes.

    Parameters
    ----------
    scene : Scene
        Scene that is changed.
    grid : mapping of str to values
        Dotted keys and the values that each takes; all combinations are run. ``dt``, ``t_end`` and
        ``method`` are keys as well, for cases with their own.
    cases : sequence of mapping
        Further changes, one by one.
    measure : function of Trajectory
        Results of a run to store, by name, as numbers. It must be a function that other
        processes can have.
    dt : float or str
        Time step [s] of cases that have none of their own, as in `simulate`.
    t_end : float, optional
        End [s] of cases that have none of their own; each run has one thread.
    method : str, Method or mapping
        Method of cases that have none of their own.
    out : str or Path, optional
        Directory that keeps each outcome as soon as it is there. Called again, the sweep goes on:
        a case with the same scene, settings and measure is not computed twice, nor by two sweeps
        that use the directory simultaneously. Errors of the physics are kept; what the machine did,
        such as a full disk, is tried again, and once more when the sweep is called again.
    keep_runs : bool
        Keep the whole runs in ``out`` too; a case that was cut off then goes on from its last
        checkpoint.
    executor : concurrent.futures.Executor, optional
        Executor of the cases: a Dask client's ``get_executor()``, an MPIPoolExecutor, ... It is
        left open. Without: processes on this machine.
    workers : int, optional
        Number of processes, from 1; as many as there are processors if not given.
    progress : bool
        Show a progress bar on standard error.
    title : str
        Title of the progress bar.

    Returns
    -------
    Study
        Also of the cases that failed, such as by a ``t_end`` below 0: their row tells why.

    Raises
    ------
    InputError
        If the study has no case, two are alike, a change, a time step or a method does not fit, ``workers``
        is below 1, ``keep_runs`` is asked for without ``out``, or ``out`` cannot be made.
    ExecutorLostError
        If the scheduler of a cluster is gone; ``out`` keeps what was done.
    KeyboardInterrupt
        On Ctrl-C; ``out`` keeps what was done.

    Warns
    -----
    UserWarning
        Once, where cases raised warnings: how many, and the first. The table has all of them.
    """
    if keep_runs and out is None:
        raise InputError("keep_runs = True needs out, the directory to keep them in")
    if workers is not None and workers < 1:
        raise InputError(f"workers = {workers}; give a number of processes from 1")
    settings = {"dt": dt, "t_end": t_end, "method": method}
    every = make_cases(scene, grid or {}, cases, settings, measure)
    directory = None if out is None else Path(out).absolute()
    if directory is not None:
        make_directory(OutcomeCache(directory).files.directory)
    done = _stored_outcomes(every, directory)
    reused = len(done)
    waiting = [case for case in every if case.key not in done]
    with (
        case_executor(executor, min(len(waiting), workers or os.cpu_count() or 1)) as pool,
        progress_bar(
            wanted=progress, total=len(every), initial=reused, desc=title, unit="case", smoothing=0.1
        ) as bar,
    ):
        failed = 0
        for case, outcome in compute_outcomes_with_retries(waiting, measure, directory, keep_runs, pool):
            done[case.key] = outcome
            failed += outcome.error is not None
            if failed:
                bar.set_postfix_str(f"{failed} failed", refresh=False)
            bar.update()
    study = Study(tuple(every), tuple(done[case.key] for case in every), reused)
    _warn_of_doubtful_cases(study)
    return study


def _warn_of_doubtful_cases(study: Study) -> None:
    pairs = zip(study.cases, study.outcomes, strict=True)
    doubtful = [(case, outcome.warning) for case, outcome in pairs if outcome.warning is not None]
    if doubtful:
        case, words = doubtful[0]
        changes = ", ".join(f"{key} = {value}" for key, value in case.changes.items())
        warnings.warn(
            f"{len(doubtful)} of {len(study.cases)} cases are in doubt (see the table), the first "
            f"({sanitize(changes)}): {words}",
            stacklevel=3,
        )


def _stored_outcomes(cases: Sequence[Case], directory: Path | None) -> dict[str, CaseOutcome]:
    if directory is None:
        return {}
    cache = OutcomeCache(directory)
    result = {case.key: cache.read(case.key) for case in cases}
    return {key: outcome for key, outcome in result.items() if outcome is not None}


def compute_outcomes_with_retries(
    cases: Sequence[Case], measure: Measure, directory: Path | None, keep_runs: bool, pool: Executor
) -> Iterator[tuple[Case, CaseOutcome]]:
    """Compute cases as the executor is free, and try again those that failed by the machine."""
    waiting = {case.key: case for case in cases}
    deaths, alone = 0, 0
    put_off: dict[str, set[str]] = {MACHINE: set(), ELSEWHERE: set()}
    unkept: list[tuple[Case, CaseOutcome]] = []
    while waiting:
        batch = list(waiting.values())[: 1 if alone else None]
        lost = {case.key for case in batch}
        submitted = [(case, case.key in put_off[ELSEWHERE]) for case in batch]
        for case, outcome in _compute_cases(submitted, measure, directory, keep_runs, pool):
            lost.discard(case.key)
            cause = outcome.cause
            if cause in put_off and case.key not in put_off[cause]:
                put_off[cause].add(case.key)
                waiting[case.key] = waiting.pop(case.key)
                continue
            del waiting[case.key]
            if cause is None and _store_outcome(case, outcome, directory).cause is not None:
                unkept.append((case, outcome))
                continue
            yield case, outcome
        alone = max(0, alone - 1)
        if not lost:
            continue
        deaths += 1
        if deaths >= ATTEMPTS and len(batch) == 1:
            del waiting[batch[0].key]
            yield batch[0], CaseOutcome(error=f"the worker died, {ATTEMPTS} times", cause=MACHINE)
            deaths, alone = 0, 0
        # A worker that dies takes its other cases along. So the next ones, of which one was running then, are
        # tried alone: who dies alone has nobody else to blame.
        elif deaths >= ATTEMPTS - 1:
            alone = 2 * (os.cpu_count() or 1)
    for case, outcome in unkept:
        yield case, _store_outcome(case, outcome, directory)


def _compute_cases(
    cases: Sequence[tuple[Case, bool]],
    measure: Measure,
    directory: Path | None,
    keep_runs: bool,
    pool: Executor,
) -> Iterator[tuple[Case, CaseOutcome]]:
    """Cases, with whether each is waited for elsewhere, as they come; the rest is taken back at the end."""
    futures: dict[Future[CaseOutcome], Case] = {}
    try:
        with contextlib.suppress(concurrent.futures.BrokenExecutor):
            for case, wait in cases:
                futures[pool.submit(compute_case, case, measure, directory, keep_runs, wait)] = case
        for future in concurrent.futures.as_completed(futures):
            outcome = future_outcome(future)
            if outcome is not None:
                yield futures[future], outcome
    finally:
        # Processes of ours end with all their tasks; loky stumbles over tasks taken back before.
        if not isinstance(pool, ProcessPool):
            for future in futures:
                future.cancel()


def _store_outcome(case: Case, outcome: CaseOutcome, directory: Path | None) -> CaseOutcome:
    """Keep an outcome that its worker has not kept, whose disk may be another, and return it."""
    if directory is None:
        return outcome
    cache = OutcomeCache(directory)
    try:
        if cache.read(case.key, warn=False) is None:  # a damaged one was told of before
            cache.keep(case.key, outcome)
    except StoreError as error:
        return dataclasses.replace(outcome, error=f"{type(error).__name__}: {error}", cause=MACHINE)
    return outcome


def future_outcome(future: Future[CaseOutcome]) -> CaseOutcome | None:
    """Take the outcome that a worker returned."""
    try:
        return future.result()
    except (concurrent.futures.BrokenExecutor, concurrent.futures.CancelledError):
        return None
    except Exception as error:
        if type(error).__name__ == "KilledWorker":  # of Dask, which is imported only by its users
            return None
        return CaseOutcome(error=f"{type(error).__name__}: {error}", cause=PROGRAM)


KEYS = ("scene", "measure", "dt", "t_end", "method", "changes", "grid", "cases")


def load_study(path: str | Path, user_measures: Mapping[str, Measure] | None = None) -> dict[str, Any]:
    """Read a study's TOML file into the arguments of `sweep`."""
    path = Path(path)
    plain = read_toml(path)
    for key in plain:
        if key not in KEYS:
            raise InputError(f"{path.name}: {unknown_word_message(key, KEYS, 'key')}")
    if "scene" not in plain:
        raise InputError(f"{path.name}: scene must be given, a packaged one or a path")
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
    """Nested tables as dotted keys: TOML reads piston.mass = 1 as a table of its own."""
    flat: dict[str, Any] = {}
    for key, value in changes.items():
        name = f"{above}.{key}" if above else key
        nested = isinstance(value, dict) and name != "method"  # a method may be given by its table
        flat |= _flatten_keys(value, name) if nested else {name: value}
    return flat


T = TypeVar("T")


class BackgroundCase(NamedTuple):
    """A case that was handed to an executor."""

    case: Case
    future: Future[CaseOutcome]


@dataclasses.dataclass(frozen=True)
class BackgroundCall(Generic[T]):
    """A call that was handed to a process; None: that its caller is to make."""

    future: Future[T] | None
    function: Callable[..., T]
    args: tuple[Any, ...]

    def result(self) -> T:
        """Wait for the call, or make it here if no process has begun it, or its process died."""
        if self.future is not None and not self.future.cancel():
            with contextlib.suppress(BrokenExecutor):
                return self.future.result()
        return self.function(*self.args)


class BackgroundCaseRunner:
    """Cases that are computed while the caller works; what nobody waits for is ended."""

    def __init__(self, measure: Measure, executor: Executor | None) -> None:
        self._measure, self._own = measure, executor is None
        # One processor stays for the caller, who works meanwhile.
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
        """Hand cases to the executor, without waiting for them."""
        started = []
        for case in make_cases(scene, {}, changes, settings, self._measure) if changes else ():
            try:
                future = self._pool.submit(compute_case, case, self._measure, None, False, True)
            except BrokenExecutor as error:  # whoever waits tries again
                future = Future()
                future.set_exception(error)
            started.append(BackgroundCase(case, future))
        self._started += started
        return started

    def submit_call(self, function: Callable[..., T], *args: Any, here: bool = False) -> BackgroundCall[T]:
        """Hand a call to the processes of this machine; another executor is for runs alone."""
        future: Future[T] | None = None
        if self._own and not here:
            with contextlib.suppress(BrokenExecutor):  # whoever asks for the result computes it
                future = self._pool.submit(function, *args)
        return BackgroundCall(future, function, args)

    def wait_for_outcomes(
        self, started: Sequence[BackgroundCase], title: str, progress: bool
    ) -> list[CaseOutcome]:
        """Wait for cases, and compute the last ones; those whose process died are tried again."""
        waiting = {entry.future for entry in started}
        done = {future for future in waiting if future.done()}
        outcomes: dict[str, CaseOutcome] = {}
        with progress_bar(
            wanted=progress, total=len(started), initial=len(done), desc=title, unit="run"
        ) as bar:
            for entry in reversed(started):
                if self._own and entry.future.cancel():
                    outcomes[entry.case.key] = compute_case(entry.case, self._measure, None, False)
                    waiting.remove(entry.future)
                    bar.update()
            for _ in concurrent.futures.as_completed(waiting - done):
                bar.update()
        for entry in started:
            if entry.future in waiting and (outcome := future_outcome(entry.future)) is not None:
                outcomes[entry.case.key] = outcome
        lost = [entry.case for entry in started if entry.case.key not in outcomes]
        for case, outcome in compute_outcomes_with_retries(lost, self._measure, None, False, self._pool):
            outcomes[case.key] = outcome
        return [outcomes[entry.case.key] for entry in started]
