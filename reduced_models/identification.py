"""`identify`: from a scene, a run or a lab record to its equation, judged and written down."""

from __future__ import annotations

import dataclasses
import math
import time
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.errors import GranularError, InputError
from granular.record import PistonRecord
from granular.scene import Scene
from reduced_models.checks import Case, Failure, run_cases, seed_cases, step_case
from reduced_models.fitting import STARTS, check_options, fit
from reduced_models.laws import law_named
from reduced_models.model import ReducedModel
from reduced_models.sources import (
    METHOD,
    RunOptions,
    prepared,
    record_of,
    run_notes,
    step_text,
)

if TYPE_CHECKING:
    from granular.trajectory import Trajectory

LAWS = ("linear", "van-der-pol-like")
TIE = 0.05
"""Hold-out errors closer than this fraction do not tell two laws apart."""
_NO_BETTER = 0.9
"""A hold-out error above this share of a resting piston's judges nothing."""
_UNITS = {"height": "m", "period": "s", "damping_ratio": ""}


@dataclasses.dataclass(frozen=True)
class Figure:
    """A number with all its uncertainties.

    Attributes
    ----------
    value : float
    interval : (float, float)
        Confidence interval of the fit.
    step_error : float or None
        Estimated error of the simulation's time step, from a run with half the step and the same
        fit of the same law.
    seed_spread : float or None
        Standard deviation over random starts of the bed.
    """

    value: float
    interval: tuple[float, float]
    step_error: float | None = None
    seed_spread: float | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Identification:
    """What was identified.

    Attributes
    ----------
    record : PistonRecord
    models : tuple of ReducedModel
        One a law, in the order asked for.
    best : ReducedModel
        The simplest of those with the least hold-out error.
    verdict : str
        In plain words.
    run : Trajectory or None
        Where the record comes from a simulation.
    figures : mapping of str to Figure
        ``height`` [m], ``period`` [s] and ``damping_ratio`` of the small swing about rest.
    figures_law : str
        The law whose fit they come from.
    notes : tuple of str
        What is to be doubted in the run or its checks.
    seconds : mapping of str to float
        Wall time of each part.
    """

    record: PistonRecord
    models: tuple[ReducedModel, ...]
    best: ReducedModel
    verdict: str
    run: Trajectory | None
    figures: Mapping[str, Figure]
    figures_law: str
    notes: tuple[str, ...]
    seconds: Mapping[str, float]

    def save(self, out: str | Path) -> None:
        """Write report.html, model.json (the best), models/ (all) and record.csv to a directory."""
        from reduced_models.report import identification_page

        out = Path(out)
        (out / "models").mkdir(parents=True, exist_ok=True)
        self.record.to_csv(out / "record.csv")
        self.best.save(out / "model.json")
        for model in self.models:
            model.save(out / "models" / f"{model.law.name}.json")
        identification_page(self).save(out / "report.html")

    def to_plain(self) -> dict[str, Any]:
        """Figures, verdict and models as plain data."""
        return {
            "verdict": self.verdict,
            "best": self.best.law.name,
            "models": [model.to_plain() for model in self.models],
            "figures": {name: dataclasses.asdict(figure) for name, figure in self.figures.items()},
            "figures_law": self.figures_law,
            "notes": list(self.notes),
            "time_step": None if self.run is None else step_text(self.run),
            "seconds": dict(self.seconds),
        }

    def __str__(self) -> str:
        lines = [*map(str, self.models), "", self.verdict]
        if self.figures:
            lines.append(f"small swing about rest, by {self.figures_law}:")
        lines += [f"  {_figure_text(name, figure)}" for name, figure in self.figures.items()]
        if self.run is not None:
            method = self.run.settings()["method"]
            lines.append(f"simulated with {method}, time step {step_text(self.run)}")
        return "\n".join([*lines, *(f"note: {note}" for note in self.notes)])


def _figure_text(name: str, figure: Figure) -> str:
    low, high = figure.interval
    text = f"{name.replace('_', ' ')} {figure.value:.5g} {_UNITS[name]}".rstrip()
    text += f"  [{low:.5g}, {high:.5g}]"
    if figure.step_error is not None:
        text += f", step error {figure.step_error:.2g}"
    if figure.seed_spread is not None:
        text += f", scatter over random starts {figure.seed_spread:.2g}"
    return text


def identify(
    source: str | Path | Scene | Trajectory | PistonRecord,
    out: str | Path | None = None,
    *,
    laws: Sequence[str] = LAWS,
    changes: Mapping[str, Any] | None = None,
    dt: float | str = "auto",
    method: str = METHOD,
    threads: int | None = None,
    starts: int = STARTS,
    checks: bool = True,
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
    laws : sequence of str
    changes : mapping, optional
        Dotted keys of the scene and their new values.
    dt, method, threads : optional
        As for `granular.simulate`; for a scene only.
    starts : int
        Random starts of each fit.
    checks : bool
        Also run the scene of a simulated record with half its time step and from other random
        starts, to give the figures their step error and scatter. What was identified is saved
        before; a check that fails becomes a note.
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
        law_named(law)
    check_options(starts=starts)
    options = RunOptions(changes or {}, dt, method, threads, progress)
    target = prepared(out)
    clock = _Clock()
    record, run = record_of(source, target, options)
    clock.lap("record" if run is None else "simulation")
    models = []
    for law in laws:
        models.append(fit(record, law, starts=starts))
        clock.lap(f"fit of {law}")
    found = _judged(record, tuple(models), run, clock.seconds)
    if target is not None:
        found.save(target)
    if checks and run is not None and run.complete and found.figures:
        found = _checked(found, run, progress)
        clock.lap("checks of step and seeds")
        if target is not None:
            found.save(target)
    return found


def _judged(
    record: PistonRecord,
    models: tuple[ReducedModel, ...],
    run: Trajectory | None,
    seconds: Mapping[str, float],
) -> Identification:
    best, verdict = choose(models)
    notes = () if run is None else run_notes(run)
    for note in notes:
        warnings.warn(note, stacklevel=3)
    shown = next((model for model in (best, *models) if model.at_rest is not None), best)
    return Identification(
        record=record,
        models=models,
        best=best,
        verdict=verdict,
        run=run,
        figures=_figures(shown),
        figures_law=shown.law.name,
        notes=notes,
        seconds=seconds,
    )


class _Clock:
    """Wall time of the parts."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.seconds[name] = now - self._last
        self._last = now


def choose(models: Sequence[ReducedModel]) -> tuple[ReducedModel, str]:
    """The best of some models of one record, and why, in plain words.

    The held-out stretch that judges the laws also chooses between them, so the chosen one's error
    is, if anything, flattered; the more so the more laws there are.
    """
    least = min(models, key=_error)
    equals = [model for model in models if _error(model) <= (1.0 + TIE) * _error(least) + 1e-9]
    best = min(equals, key=_size)
    words = _prediction(best)
    for model in models:
        if model is best:
            continue
        if model in equals:
            words += (
                f"; {model.law.name} does no better ({_percent(_error(model))}) with no fewer "
                "parameters, so these data cannot tell the two apart"
            )
        else:
            ratio = _error(model) / max(_error(best), 1e-300)
            words += f"; {model.law.name} is {ratio:.2g} times worse"
    return best, words + "."


def _error(model: ReducedModel) -> float:
    holdout = model.quality.holdout
    return model.quality.relative if holdout is None else holdout


def _size(model: ReducedModel) -> int:
    return len(model.parameters) + (2 if model.map.fitted else 0)


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"


def _prediction(model: ReducedModel) -> str:
    """What a model's error is, beside that of a piston which stays at rest."""
    quality, name = model.quality, model.law.name
    if quality.holdout is None or quality.holdout_at_rest is None:
        return f"{name} leaves {_percent(quality.relative)} of the rms swing over"
    words = (
        f"{name} predicts the held-out stretch to {_percent(quality.holdout)} of the rms swing "
        f"(a piston that stays at rest: {_percent(quality.holdout_at_rest)})"
    )
    if quality.holdout > _NO_BETTER * quality.holdout_at_rest:
        words += ", no better than rest, so that stretch does not judge the law"
    return words


def _figures(model: ReducedModel) -> dict[str, Figure]:
    """Rest height, period and damping ratio of a model."""
    if model.at_rest is None:
        return {}
    values = dataclasses.asdict(model.at_rest)
    return {name: Figure(values[name], pair) for name, pair in model.at_rest.intervals.items()}


# Checks ----------------------------------------------------------------------------------------


def _checked(found: Identification, run: Trajectory, progress: bool) -> Identification:
    """What was identified, with step errors and scatter, and notes of checks that failed."""
    model = next(model for model in found.models if model.law.name == found.figures_law)
    cases = [step_case(run), *seed_cases(run)]
    results = [
        _refitted(case, record, found.record, model)
        for case, record in zip(cases, run_cases(cases, progress), strict=True)
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
        best=models[found.models.index(found.best)],
        figures=_with_errors(found.figures, values[0], values[1:], _step_factor(run)),
        notes=found.notes + notes,
    )


def _step_factor(run: Trajectory) -> float:
    """Error of a step over what halving it changes, for a method of order p: 2^p/(2^p - 1)."""
    from granular.methods import method_named

    doubled = 2.0 ** method_named(run.settings()["method"]).order
    return doubled / (doubled - 1.0)


def _refitted(
    case: Case, record: PistonRecord | Failure, original: PistonRecord, model: ReducedModel
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
        return Failure(case.what, str(error))
    if found.at_rest is None:
        return Failure(case.what, "its fit has no level of rest")
    values = dataclasses.asdict(found.at_rest)
    return {name: values[name] for name in model.at_rest.intervals} if model.at_rest else {}


def _with_errors(
    figures: Mapping[str, Figure],
    finer: Mapping[str, float] | None,
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
            step_error=None if finer is None else factor * abs(figure.value - finer[name]),
            seed_spread=float(np.std(values, ddof=1)) if len(values) > 1 else None,
        )
    return checked
