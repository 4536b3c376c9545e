"""What further runs of its scene say of an identification: step error, scatter, lift, falls."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from typing import TYPE_CHECKING

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import GranularError
from reduced_models.fitting.fitting import fit
from reduced_models.identification.checks import (
    CHECK_SEEDS,
    Failure,
    RunCheck,
    checked_records,
    held_out_lift,
    seed_checks,
    step_check,
)
from reduced_models.identification.comparison import judged_on
from reduced_models.identification.data import Figure
from reduced_models.identification.fall_checks import fall_checks, fall_of, falls_of
from reduced_models.identification.result import Identification
from reduced_models.models.model import ReducedModel

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory


def figures_of(model: ReducedModel) -> dict[str, Figure]:
    """Rest height, period and damping ratio of a model."""
    if model.at_rest is None:
        return {}
    values = dataclasses.asdict(model.at_rest)
    return {name: Figure(values[name], pair) for name, pair in model.at_rest.intervals.items()}


def with_checks(
    found: Identification,
    run: Trajectory,
    executor: Executor | None,
    progress: bool,
    falls: bool = True,
) -> Identification:
    """What was identified, judged on another lift and other falls, with step errors and scatter.

    A check that fails becomes a note. The other lift is run where there are laws to choose from,
    and other falls, if asked for, where the scene begins with one.
    """
    step, seeds = step_check(run), seed_checks(run)
    lift = held_out_lift(run.scene) if len(found.models) > 1 else None
    fall = fall_of(run, found.figures["period"].value) if falls else None
    others = [] if fall is None else fall_checks(run, fall)
    asked = [step.check, *seeds, *([] if lift is None else [lift]), *others]
    records = checked_records(run, asked, executor, progress)
    failures = [one for one in records if isinstance(one, Failure)]
    other = None if lift is None else records[1 + CHECK_SEEDS]
    if isinstance(other, PistonRecord):
        found = _judged_on_lift(found, other)
    if fall is not None:
        judged = falls_of(run, fall, others, records[len(records) - len(others) :])
        if isinstance(judged, Failure):
            failures.append(judged)
        else:
            found = dataclasses.replace(found, falls=judged)
    model = found.shown
    results = [
        _refitted(check, record, found.record, model)
        for check, record in zip(asked[: 1 + CHECK_SEEDS], records, strict=False)
    ]
    failures += [one for one in results if isinstance(one, Failure) and one not in failures]
    notes = tuple(f"the check with {one.what} failed: {one.cause}" for one in failures)
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


def _judged_on_lift(found: Identification, lift: PistonRecord) -> Identification:
    """The laws ranked anew, and the figures of the one that is best now."""
    table = judged_on(found.comparison, [lift])
    order = [row.models[0] for row in table.rows if row.models]
    shown = next((model for model in order if model.at_rest is not None), order[0])
    return dataclasses.replace(
        found, comparison=table, lift=lift, figures=figures_of(shown), figures_law=shown.law.name
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
