"""`identify`: from a scene, a run or a lab record to its equation, judged and written down."""

from __future__ import annotations

import dataclasses
import math
import time
import warnings
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import GranularError, InputError
from reduced_models.fitting.fitting import fit
from reduced_models.fitting.options import STARTS, check_options
from reduced_models.identification.checks import (
    Failure,
    RunCheck,
    checked_records,
    seed_checks,
    step_check,
)
from reduced_models.identification.comparison import Comparison, compare, law_name
from reduced_models.identification.data import Figure
from reduced_models.identification.result import Identification
from reduced_models.laws.catalogue import law_named
from reduced_models.laws.law import Law
from reduced_models.models.model import ReducedModel
from reduced_models.records.sources import (
    METHOD,
    RunOptions,
    prepared,
    record_of,
    run_notes,
)

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene

LAWS = ("linear", "van-der-pol-like")


def identify(
    source: str | Path | Scene | Trajectory | PistonRecord,
    out: str | Path | None = None,
    *,
    laws: Sequence[str | Law] = LAWS,
    discovery: str | None = None,
    changes: Mapping[str, Any] | None = None,
    dt: float | str = "auto",
    method: str = METHOD,
    threads: int | None = None,
    starts: int = STARTS,
    checks: bool = True,
    executor: Executor | None = None,
    progress: bool = True,
) -> Identification:
    """Identify the law of a piston's motion.

    Parameters
    ----------
    source : str, Path, Scene, Trajectory or PistonRecord
        A scene (its packaged name or TOML file), a run directory, a CSV file, or one of these as
        an object. A scene is simulated first.
    out : str or Path, optional
        Directory for the report, the models, the record and the run. A run of the same scene that
        lies there already is used, or gone on with.
    laws : sequence of str or Law
        Names, equations or laws.
    discovery : str, optional
        Also discover a law by this method, and compare it with the others.
    changes : mapping, optional
        Dotted keys of the scene and their new values.
    dt, method, threads : optional
        As for `granular.simulate`; for a scene only.
    starts : int
        Random starts of each fit.
    checks : bool
        Also run the scene of a simulated record with another time step and from other random
        starts, to give the figures their step error and scatter. What was identified is saved
        before; a check that fails becomes a note.
    executor : concurrent.futures.Executor, optional
        Where the checks run, as in `granular.sweep`; processes on this machine if not given.
    progress : bool

    Raises
    ------
    InputError, RunError
        As `granular.simulate` and `fit`.

    Warns
    -----
    UserWarning
        For each note: a run that was cut, a check that failed, and those of `fit`.
    """
    if not laws:
        raise InputError("laws is empty; name at least one")
    for law in laws:
        if isinstance(law, str) and "'" not in law and "=" not in law:
            law_named(law)
    check_options(starts=starts)
    options = RunOptions(changes or {}, dt, method, threads, progress)
    target = prepared(out)
    clock = _Stopwatch()
    record, run = record_of(source, target, options)
    clock.lap("record" if run is None else "simulation")
    wanted: list[Any] = list(laws)
    if discovery is not None:
        wanted.append(_discovered(record, discovery))
        clock.lap(f"discovery by {discovery}")
    comparison = compare(record, wanted, starts=starts)
    clock.lap("fits and comparison")
    found = _judged(record, comparison, wanted, run, clock.seconds)
    if target is not None:
        found.save(target)
    if checks and run is not None and run.complete and found.figures:
        found = _checked(found, run, executor, progress)
        clock.lap("checks of step and seeds")
        if target is not None:
            found.save(target)
    return found


def _discovered(record: PistonRecord, method: str) -> ReducedModel:
    from reduced_models.discovery.discovering import discover

    return discover(record, method=cast("Any", method)).model


def _judged(
    record: PistonRecord,
    comparison: Comparison,
    wanted: Sequence[Any],
    run: Trajectory | None,
    seconds: Mapping[str, float],
) -> Identification:
    names = [law_name(law) for law in wanted]
    sound = [row for row in comparison.rows if row.models]
    models = tuple(row.models[0] for row in sorted(sound, key=lambda row: names.index(row.name)))
    notes = () if run is None else run_notes(run)
    failures = tuple(
        f"the fit of {row.name} failed: {row.failure}" for row in comparison.rows if row.failure
    )
    doubts = [f"fit of {model.law.name}: {note}" for model in models for note in model.notes]
    for note in (*notes, *failures, *doubts):
        warnings.warn(note, stacklevel=3)
    best = comparison.best
    shown = next((model for model in (best, *models) if model.at_rest is not None), best)
    return Identification(
        record=record,
        models=models,
        comparison=comparison,
        run=run,
        figures=_figures(shown),
        figures_law=shown.law.name,
        notes=(*notes, *failures),
        seconds=seconds,
    )


class _Stopwatch:
    """Wall time of the parts."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.seconds[name] = now - self._last
        self._last = now


def _figures(model: ReducedModel) -> dict[str, Figure]:
    """Rest height, period and damping ratio of a model."""
    if model.at_rest is None:
        return {}
    values = dataclasses.asdict(model.at_rest)
    return {name: Figure(values[name], pair) for name, pair in model.at_rest.intervals.items()}


# Checks ----------------------------------------------------------------------------------------


def _checked(
    found: Identification, run: Trajectory, executor: Executor | None, progress: bool
) -> Identification:
    """What was identified, with step errors and scatter, and notes of checks that failed."""
    model = next(model for model in found.models if model.law.name == found.figures_law)
    step = step_check(run)
    asked = [step.check, *seed_checks(run)]
    records = checked_records(run, asked, executor, progress)
    results = [
        _refitted(check, record, found.record, model)
        for check, record in zip(asked, records, strict=True)
    ]
    notes = tuple(
        f"the check with {result.what} failed: {result.cause}"
        for result in results
        if isinstance(result, Failure)
    )
    for note in notes:
        warnings.warn(note, stacklevel=3)
    values = [None if isinstance(result, Failure) else result for result in results]
    models = tuple(
        dataclasses.replace(each, notes=each.notes + notes) if each is model else each
        for each in found.models
    )
    return dataclasses.replace(
        found,
        models=models,
        figures=_with_errors(found.figures, values[0], values[1:], step.factor),
        notes=found.notes + notes,
    )


def _refitted(
    check: RunCheck, record: PistonRecord | Failure, original: PistonRecord, model: ReducedModel
) -> dict[str, float] | Failure:
    """The figures of a check's record, over the same duration and by the same law and map."""
    if isinstance(record, Failure):
        return record
    start = float(record.time[0])
    duration = float(original.time[-1] - original.time[0])
    try:
        part = record.between(start, start + duration * (1.0 + 1e-9))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = fit(
                part,
                model.law,
                map="fitted" if model.map.fitted else model.map,
                starts=model.quality.starts,
                holdout=0.0,
            )
    except GranularError as error:
        return Failure(check.what, str(error))
    if found.at_rest is None:
        return Failure(check.what, "its fit has no level of rest")
    values = dataclasses.asdict(found.at_rest)
    return {name: values[name] for name in model.at_rest.intervals} if model.at_rest else {}


def _with_errors(
    figures: Mapping[str, Figure],
    other: Mapping[str, float] | None,
    scattered: Sequence[Mapping[str, float] | None],
    factor: float,
) -> dict[str, Figure]:
    """Figures with their step error and scatter, as far as there are runs for them."""
    checked = {}
    for name, figure in figures.items():
        values = [figure.value, *(found[name] for found in scattered if found is not None)]
        values = [value for value in values if math.isfinite(value)]
        checked[name] = dataclasses.replace(
            figure,
            step_error=None if other is None else factor * abs(figure.value - other[name]),
            seed_spread=float(np.std(values, ddof=1)) if len(values) > 1 else None,
        )
    return checked
