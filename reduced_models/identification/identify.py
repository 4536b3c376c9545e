"""`identify`: from a scene, a run or a lab record to its equation, judged and written down."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from granular.run.piston_record import PandasOrXarray, PistonRecord
from granular.shared.errors import CautionWarning, GranularError, InputError, RecordWarning, TimeBudgetError
from granular.shared.message_text import quote, sanitize
from reduced_models.fitting.options import STARTS, check_fit_options
from reduced_models.fitting.problem import record_from_table
from reduced_models.identification.candidate_laws import (
    candidate_force_laws,
    choose_candidate_laws,
    drive_option_text,
    driven_law,
    unused_columns,
)
from reduced_models.identification.comparison import (
    compare,
    compare_on_further_records,
    law_name,
    merge_comparisons,
)
from reduced_models.identification.comparison_table import Comparison
from reduced_models.identification.measured_swing import MeasuredSwing, measure_swing
from reduced_models.identification.residual_tests import residual_tests
from reduced_models.identification.result import Identification
from reduced_models.identification.scene_checks import (
    RecordsOfRest,
    SceneChecks,
    add_check_errors,
    compile_fits_ahead,
    end_time_of_open_run,
    friction_of,
    read_parts_of_source,
    release_stages,
    rest_of,
)
from reduced_models.identification.wells import well_quantities
from reduced_models.laws.catalogue import LAWS, law_named
from reduced_models.laws.force_laws import FORCE_LAWS
from reduced_models.laws.law import Law
from reduced_models.least_squares.levenberg_marquardt import spent_budget_text, time_budget
from reduced_models.models.model import ReducedModel
from reduced_models.models.printed_model import swing_quantities
from reduced_models.models.quantities import QuantityWithError
from reduced_models.records.sensor_artefacts import keep_text, spike_mask, with_note, without_clipped_samples
from reduced_models.records.sources import (
    METHOD,
    STEP,
    RunOptions,
    incomplete_run_notes,
    make_directory,
    open_and_check_source,
    run_plan,
)

RUNS = 9
"""Runs of a scene and of its checks, which share what is compiled."""
GLANCED = "sindy"
"""Method of a discovery that nobody asked for: it needs nothing beyond what a fit needs."""
BUDGET = 300.0
"""Processor time for discovery and fits [s], ten times what a damper's swing takes."""
POOR = 0.05
"""Held-out error, in rms swings, from which a law is poor where the noise is less than that."""
LEAVES = 0.1
"""Held-out error, in rms swings, from which a law is discovered where the known ones leave more."""
_NOISE_TIMES = 3.0
_OPEN = 2.5e-3  # relative error of a frequency that is noted: 5 % of noise on 8 samples a cycle leaves less
_USEFUL_TURNS = 4.0  # periods of a record, below which it says little of a law

if TYPE_CHECKING:
    from granular.linear import MotionFriction
    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene
    from granular.studies.background_cases import BackgroundCaseRunner


def identify(
    source: str | Path | Scene | Trajectory | PistonRecord | PandasOrXarray,
    out: str | Path | None = None,
    *,
    laws: Sequence[str | Law] | None = None,
    discovery: str | None = None,
    drive: str | None = None,
    mass: float | None = None,
    changes: Mapping[str, Any] | None = None,
    parts: Mapping[str, str | float] | None = None,
    dt: float | str | None = None,
    method: str = METHOD,
    threads: int | None = None,
    starts: int = STARTS,
    budget: float = BUDGET,
    checks: bool = True,
    executor: Executor | None = None,
    progress: bool = True,
    announce: Callable[[Identification], None] | None = None,
) -> Identification:
    """Identify the law of a piston's motion.

    Parameters
    ----------
    source : str, Path, Scene, Trajectory, PistonRecord or table
        A scene (its packaged name or TOML file), a run directory, a CSV file, or one of these as
        an object; or a table of a record, of pandas or xarray. Times are in s, heights in m. A scene
        is simulated first. Where the heights are a prescribed stroke, the laws are those of its force.
    out : str or Path, optional
        Directory for the report, the models, the record and the run. A run of the same scene and sum that
        lies there already is used, or gone on with. Nothing is written if not given.
    laws : sequence of str or Law, optional
        Names, equations or laws. Without, those that can win: see
        `reduced_models.identification.candidate_laws`.
    discovery : str, optional
        Also discover a law by this method, and compare it with the others. Where no laws are named
        and other terms explain the record clearly better, a law is discovered by ``"sindy"``.
    drive : str, optional
        Column of the record that drives the motion: each of the laws has it as its input.
    mass : float, optional
        Mass of what moves [kg], above 0, for stiffness in N/m and damping in N s/m; a scene's piston
        has its own. Not for a record of an angle.
    changes : mapping, optional
        Dotted keys of the scene and their new values.
    parts : mapping of str to str or float, optional
        Tolerances of the scene's parts, as `granular.tolerances` takes them: their standard deviations of the
        figures of small motions stand apart from the errors of the figures.
    dt, method, threads : optional
        Time step [s], integration method and number of threads of the simulation; for a scene only.
        The step, if not given, is the longest whose errors random starts hide by the stored table
        of prices, and the automatic one of scenes that it does not hold; with checks, the sum over
        pairs is then the mesh where that is faster and its errors are hidden too. A scene that names
        its sum, as ``changes={"pairs.method": "direct"}``, keeps it.
    starts : int
        Number of random starts of each fit, from 1 to 10000.
    budget : float
        Processor time for discovery and fits [s], above 0. Laws whose turn comes later are left out, and a
        note names them; half of it is for a discovery.
    checks : bool
        Also run the scene of a simulated record with another time step and from other random
        starts, to give the figures their step error and scatter, and with another lift, which all
        laws then have to predict. Where no laws are named and the scene begins with a fall, laws
        of the whole fall (`reduced_models.falls.unseen_fall_scores.FALL_LAWS`) are fitted to it, and judged
        on falls from other heights and random starts. What was identified is saved before; a check
        that fails becomes a note.
    executor : concurrent.futures.Executor, optional
        Where the checks run, as in `granular.sweep`; processes on this machine if not given.
    progress : bool
        Show what is being done.
    announce : callable, optional
        Function that is handed what was identified while the checks, which are to follow, still run.

    Returns
    -------
    Identification
        Models, verdict, engineering figures (SI units, with errors) and checks. There are no figures
        where no law has a small swing about rest.

    Raises
    ------
    InputError
        If an argument is out of its range, the source is none of these, there is no law, method or
        column of a name, a scene has no piston, options of a scene are given for a run or a record,
        or no law can be fitted, as to a record that is too short or does not move, or within the
        budget.
    RecordError
        If a file or a table is no record, or the record holds no heights.
    StoreError
        If ``out`` cannot be made or written to, or a run directory cannot be read.
    RunError
        If the simulation cannot be trusted any more.

    Warns
    -----
    UserWarning
        For each note: a run that was cut, a check that failed, and those of `fit`.
    """
    _check_arguments(laws, mass)
    check_fit_options(starts=starts)
    check_budget(budget)
    target = make_directory(out)
    clock = _Stopwatch()
    options = RunOptions(changes or {}, STEP if dt is None else dt, method, threads, progress)
    opened = open_and_check_source(record_from_table(source), options)
    toleranced = None if parts is None else read_parts_of_source(opened, parts)
    lift = laws is None or len(laws) > 1
    with contextlib.ExitStack() as stack:
        if isinstance(opened, PistonRecord):
            record, run, further = without_clipped_samples(opened), None, None
        else:
            background = None
            if checks:
                from granular.scene.scene import Scene
                from granular.studies.background_cases import BackgroundCaseRunner

                scene = opened if isinstance(opened, Scene) else opened.scene
                measure = RecordsOfRest(release_stages(scene))
                background = stack.enter_context(BackgroundCaseRunner(measure, executor))
                if laws is None and scene is opened:
                    compile_fits_ahead(background, scene, starts)
            run, further = _run_beside_checks(opened, target, options, dt is None, background, lift)
            record = run.piston()
            if further is not None and laws is None:
                further.begin_fall_fits(run)
        mass = _moving_mass(mass, record, run)
        clock.lap("record" if run is None else "simulation")
        result = _fit_and_compare(record, run, laws, discovery, drive, mass, starts, budget, clock)
        if toleranced is not None and run is not None:
            from granular.studies.tolerances import tolerances_at

            of_parts = tolerances_at([rest_of(run)], toleranced, progress=progress)
            result = dataclasses.replace(result, of_parts=of_parts)
            clock.lap("tolerances of the parts")
        doubts = [f"fit of {result.best.law.name}: {note}" for note in result.best.notes]
        for note in (*result.notes, *doubts):
            warnings.warn(note, CautionWarning, stacklevel=2)
        checkable = further is not None and bool(result.figures)
        if checkable and announce is not None:
            announce(result)
        if target is not None:
            result.save(target)
        if further is None or run is None or not checkable:
            return result
        result = _add_check_outcomes(result, run, further, progress)
    clock.lap("checks of step, random starts, lift and falls")
    result = dataclasses.replace(result, seconds=dict(clock.seconds))
    if target is not None:
        result.save(target)
    return result


def _run_beside_checks(
    source: Scene | Trajectory,
    out: Path | None,
    options: RunOptions,
    free_step: bool,
    background: BackgroundCaseRunner | None,
    lift: bool,
) -> tuple[Trajectory, SceneChecks | None]:
    """Run of a scene, or one that is there; its checks, which are begun before it."""
    from granular.scene.scene import Scene

    if isinstance(source, Scene):
        from granular.run.plan import SCATTER, plan

        chosen = plan(
            source,
            options.dt,
            options.method,
            accuracy=SCATTER if free_step else None,
            threads=options.threads,
            runs=1 if background is None else RUNS,
        )
        chosen.check_arguments()
        settings = {"dt": chosen.dt, "t_end": None, "method": options.method}
        further = None if background is None else SceneChecks(background, chosen.scene, settings, lift)
        run = run_plan(chosen, out, options.progress)
        return run, further if run.complete else None
    if background is None or not source.complete:
        return source, None
    settings = {name: source.settings()[name] for name in ("dt", "method")}
    settings["t_end"] = end_time_of_open_run(source)
    return source, SceneChecks(background, source.scene, settings, lift)


def _fit_and_compare(
    record: PistonRecord,
    run: Trajectory | None,
    laws: Sequence[str | Law] | None,
    discovery: str | None,
    drive: str | None,
    mass: float | None,
    starts: int,
    budget: float,
    clock: _Stopwatch,
) -> Identification:
    """Laws of a record, fitted and compared; arguments as of `identify`."""
    friction = None if run is None else friction_of(run)
    along_stroke = record.measured == "force"
    wanted, left_out, glanced = _laws_to_fit(record, laws, drive, friction)
    discovery = discovery or glanced
    clock.lap("a glance at the laws")
    words = spent_budget_text(budget)
    with time_budget(budget, words):
        comparison = None
        if discovery is None:
            record, comparison = _compare_without_spikes(record, run, wanted, starts)
            clock.lap("fits and comparison")
            least = max(LEAVES, _NOISE_TIMES * comparison.noise)
            if laws is None and not along_stroke and comparison.rows[0].error > least:
                discovery = GLANCED
        if discovery is not None:
            from reduced_models.discovery.discover import discover

            try:
                with time_budget(0.5 * budget, words):
                    discovered = discover(
                        record,
                        method=cast("Any", discovery),
                        input=drive,
                        target="force" if along_stroke else "acceleration",
                    )
                    wanted.append(discovered.model)
                if comparison is not None:
                    comparison = merge_comparisons(comparison, compare(record, wanted[-1], starts=starts))
            except TimeBudgetError as spent:
                left_out += (f"discovery by {discovery}: {spent}",)
            except InputError as cause:
                if comparison is None:  # what was asked for
                    raise
                left_out += (f"discovery by {discovery}: {cause}",)
            clock.lap(f"discovery by {discovery}")
        if comparison is None:
            record, comparison = _compare_without_spikes(record, run, wanted, starts)
            clock.lap("fits and comparison")
    names = [law_name(law) for law in wanted]
    sound = [row for row in comparison.rows if row.models]
    models = tuple(row.models[0] for row in sorted(sound, key=lambda row: names.index(row.name)))
    best = comparison.best
    shown = next((model_ for model_ in (best, *models) if model_.at_rest is not None), best)
    figures = swing_quantities(shown, record.angle, mass)
    own, no_own = _measured_swing(record, best)
    if run is None and (wells := well_quantities(best)):
        shown, figures = best, wells
    return Identification(
        record=record,
        models=models,
        comparison=comparison,
        run=run,
        figures=figures,
        figures_law=shown.law.name,
        own=own,
        no_own=no_own,
        notes=_collect_notes(record, run, comparison, models)
        + (_frequency_error_notes(figures) if run is None and not best.notes else ()),
        seconds=dict(clock.seconds),
        mass=mass,
        friction=friction,
        left_out=left_out,
        residuals={
            model.law.name: residual_tests(model, record.time, record.signal, model.simulate_signal(record))
            for model in models
        },
        advice=suggest_next_steps(comparison, models, record, run, discovery),
    )


def _laws_to_fit(
    record: PistonRecord, laws: Sequence[str | Law] | None, drive: str | None, friction: MotionFriction | None
) -> tuple[list[Any], tuple[str, ...], str | None]:
    """Laws to fit, why others are not, and the method of a discovery that a glance calls for."""
    if laws is not None:
        return [_add_drive_to_law(law, record, drive) for law in laws], (), None
    if record.measured == "force":
        fitting = candidate_force_laws([record])
        others = (law for law in FORCE_LAWS.values() if law not in fitting)
        return fitting, tuple(f"{law.name} was not fitted: it is of heights above 0" for law in others), None
    chosen = choose_candidate_laws(record, drive, friction)
    # Noise that was integrated is no measure of what terms leave.
    discovers = chosen.screening.other_terms_fit_better and record.measured == "height"
    return list(chosen.laws), chosen.exclusion_texts, GLANCED if discovers else None


def check_budget(budget: object) -> None:
    """Refuse a processor time [s] that is none."""
    if not isinstance(budget, Real) or not float(budget) > 0.0:
        raise InputError(f"budget = {quote(budget)} s; give a time above 0")


def _measured_swing(record: PistonRecord, model: ReducedModel) -> tuple[MeasuredSwing | None, str]:
    """Frequency and damping of the record itself, or why it does not tell them."""
    if record.measured == "force":
        return None, "the record prescribes the motion"
    try:
        return measure_swing(record, model), ""
    except GranularError as error:
        return None, str(error)


def _compare_without_spikes(
    record: PistonRecord, run: Trajectory | None, laws: Sequence[Any], starts: int
) -> tuple[PistonRecord, Comparison]:
    """Comparison of laws, again without the spikes of a record if that can be finished within the budget."""
    comparison = compare(record, laws, starts=starts)
    if run is not None or record.measured == "force":
        return record, comparison
    spikes = spike_mask(record, comparison.best.simulate_record(record).height)
    if not spikes.any():
        return record, comparison
    words = (
        f"single samples that stand far off the fitted motion (spikes: {int(spikes.sum())}, the first at "
        f"{record.time[np.argmax(spikes)]:.4g} s)"
    )
    sound = with_note(record.select(~spikes), f"{words} are left out; {keep_text(record)}")
    done = {row.name for row in comparison.rows if row.models}
    try:
        second = compare(sound, laws, starts=starts)
        complete = done <= {row.name for row in second.rows if row.models}
    except InputError:  # no law, as the budget is spent
        complete = False
    if not complete:
        second = comparison
        reason = "not all laws could be fitted without them within the budget; raise --budget"
        sound = with_note(record, f"{words} stay: {reason}")
    assert sound.source is not None
    warnings.warn(sound.source.notes[-1], RecordWarning, stacklevel=4)
    return sound, second


def _check_arguments(laws: Sequence[str | Law] | None, mass: float | None) -> None:
    if laws is not None and not laws:
        raise InputError("laws is empty; name at least one")
    if isinstance(laws, str) or (laws is not None and not isinstance(laws, Iterable)):
        raise InputError(f"laws = {quote(laws)}; give names, equations or laws in a list")
    for law in laws or ():
        if isinstance(law, str) and "'" not in law and "=" not in law and law not in FORCE_LAWS:
            law_named(law)
    if mass is not None and (not isinstance(mass, Real) or not 0.0 < float(mass) < math.inf):
        raise InputError(f"mass = {quote(mass)} kg; give one above 0")


def _moving_mass(mass: float | None, record: PistonRecord, run: Trajectory | None) -> float | None:
    """Mass that moves [kg]: as given, else the piston of a scene."""
    if mass is not None and record.angle:
        raise InputError(f"mass = {mass:g} kg, and the record is one of an angle; leave it out")
    if mass is None and run is not None and run.scene.piston is not None:
        return run.scene.piston.mass
    return mass


def _add_drive_to_law(law: str | Law, record: PistonRecord, drive: str | None) -> str | Law:
    """Law that is asked for; one of the package's is driven, where a drive is named."""
    if drive is not None and isinstance(law, str) and law in LAWS:
        return driven_law(LAWS[law], record, drive)
    return law


def _collect_notes(
    record: PistonRecord, run: Trajectory | None, comparison: Comparison, models: Sequence[ReducedModel]
) -> tuple[str, ...]:
    """Doubts about a run, fits that failed, and columns that were not used."""
    notes = [] if run is None else list(incomplete_run_notes(run))
    notes += [f"the fit of {row.name} failed: {row.failure}" for row in comparison.rows if row.failure]
    if run is None:
        notes += [
            f"the column {sanitize(name)} was not used; as a drive of all laws: "
            f"{sanitize(drive_option_text(name))}"
            for name in unused_columns(record, [model.law for model in models])
        ]
    return tuple(notes)


def _frequency_error_notes(figures: Sequence[QuantityWithError]) -> tuple[str, ...]:
    """Doubt of a frequency that a record tells worse than is usual in a laboratory."""
    for figure in figures:
        error = figure.total_error / figure.value if figure.value else math.inf
        if figure.name == "natural frequency" and _OPEN < error < math.inf:
            return (
                f"noise and few swings leave the natural frequency uncertain by {100.0 * error:.2g} %; "
                "record a larger motion, more swings, or more samples of each",
            )
    return ()


def _add_check_outcomes(
    result: Identification, run: Trajectory, further: SceneChecks, progress: bool
) -> Identification:
    """Judge laws on another lift and other falls; give figures step errors and scatter."""
    # Another lift is worth a run only if there are laws to choose from.
    checks = further.wait_for_outcomes(run, progress)
    comparison, model, figures = result.comparison, result.model_of_figures, result.figures
    own, no_own = result.own, result.no_own
    record, mass = result.record, result.mass
    if checks.lift is not None and len(result.models) > 1:
        # The laws are ranked anew, and the best one now gives the figures.
        comparison = compare_on_further_records(comparison, [checks.lift])
        order = [row.models[0] for row in comparison.rows if row.models]
        model = next((entry for entry in order if entry.at_rest is not None), order[0])
        figures = swing_quantities(model, record.angle, mass)
        own, no_own = _measured_swing(record, order[0])
    duration = float(record.time[-1] - record.time[0])
    figures, parameters, own, failed = add_check_errors(figures, own, model, mass, duration, checks)
    failures = dict.fromkeys((*checks.failures, *failed))
    notes = tuple(f"the check with {entry.what} failed: {entry.cause}" for entry in failures)
    for note in notes:
        warnings.warn(note, CautionWarning, stacklevel=3)
    models = tuple(
        dataclasses.replace(entry, notes=entry.notes + notes) if entry is model else entry
        for entry in result.models
    )
    return dataclasses.replace(
        result,
        models=models,
        comparison=comparison,
        figures=figures,
        figures_law=model.law.name,
        parameters=parameters if model is comparison.best else (),
        own=own,
        no_own=no_own,
        notes=result.notes + notes,
        lift=None if comparison is result.comparison else checks.lift,
        falls=checks.falls,
        derived=checks.derived,
    )


class _Stopwatch:
    """Wall time of the parts."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self._last
        self._last = now


def suggest_next_steps(
    comparison: Comparison,
    models: Sequence[ReducedModel],
    record: PistonRecord,
    run: Trajectory | None,
    discovery: str | None,
) -> tuple[str, ...]:
    """Sentences on what to try, the most promising first; nothing where the best law is good."""
    best = comparison.rows[0]
    if best.error < max(POOR, _NOISE_TIMES * comparison.noise):
        return ()
    words = [
        f"even the best law, {best.name}, misses what it has not seen by "
        f"{100 * best.error:.3g} % of the swing"
    ]
    columns = unused_columns(record, [model.law for model in models])
    if run is None and columns:
        words.append(f"drive the laws by a column that was not used: {drive_option_text(columns[0])}")
    if record.measured == "force":
        words.append("write down a law of your own: --law \"force = c*z' + k*z + friction*tanh(z'/creep)\"")
        return tuple(words)
    if comparison.best.at_rest is not None:
        turns = float(record.time[-1] - record.time[0]) / comparison.best.at_rest.period
        if turns < _USEFUL_TURNS:
            words.append(f"record longer: {turns:.2g} periods say little of a law")
    words.append(
        "look at the record (granular-damper look FILE) and leave out its first moments, "
        "or what lies in the noise: --between T:T"
    )
    if discovery is None:
        words.append("let a law be discovered: --discover sindy")
    words += [
        "try a law with memory, as hysteresis has: --law bouc-wen, or --law rubbing-bed",
        "write down a law of your own: --law \"z'' + c*z' + k*(z - r)**3 = 0\"",
    ]
    return tuple(words)
