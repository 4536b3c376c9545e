"""`identify`: from a scene, a run or a lab record to its equation, judged and written down."""

from __future__ import annotations

import concurrent.futures
import dataclasses
import math
import multiprocessing
import os
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.errors import InputError
from granular.record import PistonRecord
from granular.scene import Scene, load_scene
from granular.store import is_run
from reduced_models.fitting import STARTS, check_options, fit
from reduced_models.laws import law_named
from reduced_models.model import ReducedModel

if TYPE_CHECKING:
    from granular.trajectory import Trajectory

LAWS = ("linear", "van-der-pol-like")
CHECK_SEEDS = 2
"""Further random starts of the bed that are run to see the scatter."""
TIE = 0.05
"""Hold-out errors closer than this fraction do not tell two laws apart."""


@dataclasses.dataclass(frozen=True)
class Figure:
    """A number with all its uncertainties.

    Attributes
    ----------
    value : float
    interval : (float, float)
        Confidence interval of the fit.
    step_error : float or None
        Estimated error of the simulation's time step, from a run with twice the step.
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
    seconds : mapping of str to float
        Wall time of each part.
    """

    record: PistonRecord
    models: tuple[ReducedModel, ...]
    best: ReducedModel
    verdict: str
    run: Trajectory | None
    figures: Mapping[str, Figure]
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
            "figures": {name: dataclasses.asdict(one) for name, one in self.figures.items()},
            "seconds": dict(self.seconds),
        }


def identify(
    source: str | Path | Scene | Trajectory | PistonRecord,
    out: str | Path | None = None,
    *,
    laws: Sequence[str] = LAWS,
    changes: Mapping[str, Any] | None = None,
    dt: float | str = "auto",
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
    dt, threads : optional
        As for `granular.simulate`.
    starts : int
        Random starts of each fit.
    checks : bool
        Also run the scene with twice the automatic step and from other random starts, to give the
        figures their step error and scatter.
    progress : bool

    Raises
    ------
    InputError, RunError
        As `granular.simulate` and `fit`.
    """
    if not laws:
        raise InputError("laws is empty; name at least one")
    for law in laws:
        law_named(law)
    check_options(starts=starts)
    clock = _Clock()
    target = None if out is None else Path(out)
    record, run = _record_of(source, target, changes, dt, threads, progress)
    clock.lap("record" if run is None else "simulation")
    models = []
    for law in laws:
        models.append(fit(record, law, starts=starts))
        clock.lap(f"fit of {law}")
    best, verdict = choose(models)
    figures = _figures(models)
    if checks and run is not None and isinstance(source, str | Path | Scene):
        figures = _with_checks(figures, run, dt, progress)
        clock.lap("checks of step and seeds")
    found = Identification(record, tuple(models), best, verdict, run, figures, clock.seconds)
    if target is not None:
        found.save(target)
    return found


class _Clock:
    """Wall time of the parts."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.seconds[name] = now - self._last
        self._last = now


def _record_of(
    source: str | Path | Scene | Trajectory | PistonRecord,
    out: Path | None,
    changes: Mapping[str, Any] | None,
    dt: float | str,
    threads: int | None,
    progress: bool,
) -> tuple[PistonRecord, Trajectory | None]:
    """The record, and the run it comes from."""
    if isinstance(source, str | Path):
        path = Path(source)
        if is_run(path):
            from granular.trajectory import load_trajectory

            source = load_trajectory(path)
        elif path.suffix not in ("", ".toml") or (path.is_file() and path.suffix != ".toml"):
            source = PistonRecord.from_csv(path)
        else:
            source = load_scene(source)
    if isinstance(source, Scene):
        from granular.simulation import simulate

        scene = source.replace(**(changes or {}))
        if scene.piston is None:
            raise InputError(f"scene {scene.name!r} has no piston, so there is nothing to identify")
        source = simulate(
            scene,
            dt=dt,
            out=None if out is None else out / "run",
            resume=out is not None,
            threads=threads,
            progress=progress,
        )
    elif changes:
        raise InputError("only a scene can be changed; this is a run or a record")
    if isinstance(source, PistonRecord):
        return source, None
    return source.piston(), source


def choose(models: Sequence[ReducedModel]) -> tuple[ReducedModel, str]:
    """The best of some models of one record, and why, in plain words."""

    def error(model: ReducedModel) -> float:
        holdout = model.quality.holdout
        return model.quality.relative if holdout is None else holdout

    def size(model: ReducedModel) -> int:
        return len(model.parameters) + (2 if model.map.fitted else 0)

    least = min(models, key=error)
    equals = [model for model in models if error(model) <= (1.0 + TIE) * error(least) + 1e-9]
    best = min(equals, key=size)
    figure = 100.0 * error(best)
    words = f"{best.law.name} predicts the held-out stretch to {figure:.2g} % of the rms swing"
    others = [model for model in models if model is not best]
    for model in others:
        if model in equals:
            words += (
                f"; {model.law.name} does no better ({100.0 * error(model):.2g} %) with more "
                "parameters, so these data cannot tell the two apart"
            )
        else:
            words += (
                f"; {model.law.name} is {error(model) / max(error(best), 1e-300):.2g} times worse"
            )
    return best, words + "."


def _figures(models: Sequence[ReducedModel]) -> dict[str, Figure]:
    """Rest height, period and damping ratio, from the first model that has them."""
    for model in models:
        if model.at_rest is not None:
            values = dataclasses.asdict(model.at_rest)
            return {
                name: Figure(values[name], pair) for name, pair in model.at_rest.intervals.items()
            }
    return {}


# Checks ----------------------------------------------------------------------------------------


def _with_checks(
    figures: Mapping[str, Figure], run: Trajectory, dt: float | str, progress: bool
) -> dict[str, Figure]:
    scene = run.scene
    seed = scene.arrangement.seed
    longer = "auto*2" if isinstance(dt, str) else 2.0 * dt
    seeds = range(seed + 1, seed + 1 + CHECK_SEEDS)
    others = [scene.replace(**{"arrangement.seed": one}).plain() for one in seeds]
    cases = [(scene.plain(), longer), *((one, dt) for one in others)]
    found = _in_parallel(cases, progress)
    checked = {}
    for name, one in figures.items():
        coarse, *scattered = (figures_of[name] for figures_of in found)
        values = [value for value in (one.value, *scattered) if math.isfinite(value)]
        # The error of a second-order method: a third of what doubling the step changes.
        checked[name] = dataclasses.replace(
            one,
            step_error=abs(coarse - one.value) / 3.0,
            seed_spread=float(np.std(values, ddof=1)) if len(values) > 1 else None,
        )
    return checked


def _in_parallel(
    cases: Sequence[tuple[dict[str, Any], float | str]], progress: bool
) -> list[dict[str, float]]:
    from tqdm import tqdm

    workers = min(len(cases), os.cpu_count() or 1)
    with concurrent.futures.ProcessPoolExecutor(
        workers, mp_context=multiprocessing.get_context("spawn")
    ) as pool:
        jobs = [pool.submit(_simulated_record, *case) for case in cases]
        try:
            for _ in tqdm(
                concurrent.futures.as_completed(jobs),
                total=len(jobs),
                desc="checks of step and seeds",
                disable=not progress,
                file=sys.stderr,
            ):
                pass
            records = [job.result() for job in jobs]
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    figures = []
    for record in records:
        at_rest = fit(PistonRecord(*record), "linear", starts=4, holdout=0.0).at_rest
        values = {} if at_rest is None else dataclasses.asdict(at_rest)
        figures.append(
            {name: values.get(name, math.nan) for name in ("height", "period", "damping_ratio")}
        )
    return figures


def _simulated_record(plain: dict[str, Any], dt: float | str) -> tuple[np.ndarray, np.ndarray]:
    """One check run, in a process of its own."""
    import warnings

    from granular.simulation import simulate

    warnings.simplefilter("ignore")  # the main run has said what there is to say
    record = simulate(Scene.from_plain(plain), dt=dt, threads=1, progress=False).piston()
    return record.time, record.height
