"""`identify`: from a scene, a run or a lab record to its equation, tested and reported."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING

from granular.records.record import PandasOrXarray, PistonRecord
from granular.shared.errors import CautionWarning, InputError, quote
from reduced_models.fitting.fit_data import record_from_table
from reduced_models.fitting.problem import STARTS, check_fit_options
from reduced_models.identification.comparison import compare_on_further_records
from reduced_models.identification.laws_of_record import (
    Stopwatch,
    backbone_compared_with_law_or_reason,
    compare_laws_of_record,
)
from reduced_models.identification.result import Identification
from reduced_models.identification.scene_checks import (
    PACKINGS,
    SceneChecks,
    SimulateReleaseFromEquilibrium,
    add_check_errors,
    compile_fits_ahead,
    end_time_of_open_run,
    equilibrium_after_first_stage,
    read_part_tolerances_of_source,
    stages_after_initial_rest,
)
from reduced_models.laws.catalogue import law_named
from reduced_models.laws.force_laws import FORCE_LAWS
from reduced_models.laws.law import Law
from reduced_models.models.printed_model import oscillation_quantities
from reduced_models.records.sensor_artefacts import without_clipped_samples
from reduced_models.records.sources import DEFAULT_METHOD, make_directory, open_and_check_source, run_plan

MAXIMUM_PACKINGS = 100
"""Maximum number of random packings; each of them needs a simulation."""
BUDGET = 300.0
"""Default processor time for discovery and fits [s]; for a damper about a tenth of this time is needed."""


@dataclasses.dataclass(frozen=True)
class IdentifyOptions:
    """Less common options of `identify`: time budget, and checks of a simulated record.

    Parameters
    ----------
    budget : float
        Processor time for discovery and fits [s], above 0. Laws that would exceed it are not fitted and
        are listed in a note; a discovery may use half of the time.
    checks : bool
        Whether to run the scene again: with another time step, for the step error of the results;
        from other random packings, for their spread; and with a higher lift, which all laws have to
        predict. If no laws are given and the scene begins with a fall, laws of the whole fall
        (`reduced_models.falls.unseen_fall_scores.FALL_LAWS`) are fitted to this fall and tested on
        falls from other heights and random packings. A check that fails becomes a note.
    executor : concurrent.futures.Executor, optional
        Executor for the runs of the checks, as in `granular.sweep`; by default local processes.
    packings : int
        Number of random packings from which the spread is computed, from 2 to 100, including the scene's
        own. If the table of settled beds (`granular.studies.packing_spread`) contains this bed, its spread
        in the table is combined with the computed one.
    parts : mapping of str to str or float, optional
        Tolerances of the scene's parts, as in `granular.tolerances`. The standard deviations that
        they cause in frequency, damping and equilibrium are printed separately from the errors.

    Raises
    ------
    InputError
        If the budget is not above 0, or the number of packings is out of range.

    Examples
    --------
    >>> from reduced_models import IdentifyOptions
    >>> IdentifyOptions(checks=False).budget
    300.0
    """

    budget: float = BUDGET
    checks: bool = True
    executor: Executor | None = None
    packings: int = PACKINGS
    parts: Mapping[str, str | float] | None = None

    def __post_init__(self) -> None:
        check_budget(self.budget)
        if not isinstance(self.packings, Integral) or not 2 <= self.packings <= MAXIMUM_PACKINGS:
            raise InputError(
                f"packings = {quote(self.packings)}; give an integer from 2 to {MAXIMUM_PACKINGS}"
            )


def check_budget(budget: object) -> None:
    """Raise an error if a processor time [s] is not above 0."""
    if not isinstance(budget, Real) or not float(budget) > 0.0:
        raise InputError(f"budget = {quote(budget)} s; give a time above 0")


RUNS = 9
"""Approximate number of runs (of the scene and of its checks) that share compiled code."""

if TYPE_CHECKING:
    from granular.run.plan import Plan
    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene
    from granular.studies.sweep import BackgroundCaseRunner


def identify(
    source: str | Path | Scene | Plan | Trajectory | PistonRecord | PandasOrXarray,
    out: str | Path | None = None,
    *,
    laws: Sequence[str | Law] | None = None,
    discovery: str | None = None,
    drive: str | None = None,
    mass: float | None = None,
    coordinates: int = 1,
    starts: int = STARTS,
    options: IdentifyOptions | None = None,
    progress: bool | Callable[[Identification], None] = True,
) -> Identification:
    """Identify the law of a piston's motion.

    Parameters
    ----------
    source : str, Path, Scene, Plan, Trajectory, PistonRecord or table
        A scene (its packaged name or TOML file), a run directory, a CSV file, or one of these as
        an object; or a record as a table of pandas or xarray. Times are in s, heights in m. A scene
        is simulated first; a `granular.Plan` also gives method, time step, threads, and the way in which
        pair forces are summed. Without a plan, a stored table of errors gives the coarsest time step with
        errors below the spread between random packings; scenes not in the table get the automatic step.
        A mesh then sums the pair forces if the scene does not prescribe their summation, a mesh is
        faster, and its errors are also below the spread. If the heights are a prescribed stroke, laws
        of the force are fitted.
    out : str or Path, optional
        Directory for the report, the models, the record and the run. If it contains a run
        of the same scene, with pair forces summed in the same way, this run is used, and continued if it
        was interrupted. Results are written before the checks and again after them. By default nothing
        is written.
    laws : sequence of str or Law, optional
        Names, equations or laws. By default `reduced_models.identification.candidate_laws` chooses the
        laws.
    discovery : str, optional
        Method of `discover`, by which a further law is found and compared with the others. By default
        a law is discovered, with ``"sindy"``, only if no laws are given and other terms describe the
        record clearly better.
    drive : str, optional
        Column of the record that drives the motion; it becomes an input of every law.
    mass : float, optional
        Moving mass [kg], above 0, which gives stiffness in N/m and damping in N s/m; by default the
        mass of a scene's piston. Not allowed for a record of an angle.
    coordinates : int
        1, or 2 if a column is a sum of two linear modes in free decay: the frequencies and damping
        ratios of both modes are fitted together, and the fit is compared with a single linear mode.
    starts : int
        Number of random starts of each fit, from 1 to 10000.
    options : IdentifyOptions, optional
        Processor time, checks of a simulated record, and tolerances of parts.
    progress : bool or callable
        Whether to show progress; or a function that is called before the checks with the
        identification.

    Returns
    -------
    Identification
        Models, verdict, checks, and frequency, damping, stiffness and equilibrium (SI units, with
        errors). The last four are missing if no law oscillates about an equilibrium.

    Raises
    ------
    InputError
        If an argument is out of range, the source is of another type, a law, method or column is
        unknown, a scene has no piston, tolerances are given for a record, or no law can be fitted, for
        example because the record is too short, nothing moves, or the budget is too small.
    RecordError
        If a file or a table is not a record, or the record holds no heights.
    StoreError
        If ``out`` cannot be created or written to, or a run directory cannot be read.
    RunError
        If the simulation becomes unreliable.

    Warns
    -----
    UserWarning
        For an interrupted run, for a failed check, and for each note of `fit`.
    """
    _check_arguments(laws, mass)
    if coordinates != 1:
        laws = _laws_of_one_and_two_modes(coordinates, laws, discovery, drive)
    check_fit_options(starts=starts)
    options = options or IdentifyOptions()
    target = None if out is None else make_directory(out)
    clock = Stopwatch()
    opened = open_and_check_source(record_from_table(source))
    parts = None if options.parts is None else read_part_tolerances_of_source(opened, options.parts)
    with contextlib.ExitStack() as stack:
        if isinstance(opened, PistonRecord):
            record, run, further = without_clipped_samples(opened), None, None
        else:
            from granular.scene.scene import Scene

            planned = (
                plan_simulation_run(opened, checks=options.checks) if isinstance(opened, Scene) else opened
            )
            background = None
            if options.checks:
                from granular.run.plan import Plan
                from granular.studies.sweep import BackgroundCaseRunner

                measure = SimulateReleaseFromEquilibrium(stages_after_initial_rest(planned.scene))
                background = stack.enter_context(BackgroundCaseRunner(measure, options.executor))
                if laws is None and isinstance(planned, Plan):
                    compile_fits_ahead(background, planned.scene, starts)
            lift = laws is None or len(laws) > 1
            run, further = _run_scene_and_start_checks(
                planned, target, background, lift, options.packings, bool(progress)
            )
            record = run.piston()
            if further is not None and laws is None:
                further.begin_fall_fits(run)
        mass = _moving_mass(mass, record, run)
        clock.lap("record" if run is None else "simulation")
        result = compare_laws_of_record(
            record, run, laws, discovery, drive, mass, starts, options.budget, clock
        )
        if parts is not None and run is not None:
            from granular.studies.tolerances import tolerances_at

            of_parts = tolerances_at([equilibrium_after_first_stage(run)], parts, progress=bool(progress))
            result = dataclasses.replace(result, of_parts=of_parts)
            clock.lap("tolerances of the parts")
        fit_notes = [f"fit of {result.best.law.name}: {note}" for note in result.best.notes]
        for note in (*result.notes, *fit_notes):
            warnings.warn(note, CautionWarning, stacklevel=2)
        checkable = further is not None and bool(result.figures)
        if checkable and callable(progress):
            progress(result)
        if target is not None:
            result.save(target)
        if further is None or run is None or not checkable:
            return result
        result = _add_check_outcomes(result, run, further, bool(progress))
    clock.lap("checks of time step, random packings, lift and falls")
    result = dataclasses.replace(result, seconds=dict(clock.seconds))
    if target is not None:
        result.save(target)
    return result


def plan_simulation_run(
    scene: Scene,
    dt: float | str | None = None,
    method: str = DEFAULT_METHOD,
    threads: int | None = None,
    *,
    checks: bool = True,
) -> Plan:
    """Plan a scene's run; by default its errors due to the time step are below the spread over packings."""
    from granular.run.plan import SCATTER, plan

    accuracy = SCATTER if dt is None else None
    step = "auto" if dt is None else dt
    return plan(scene, step, method, accuracy=accuracy, threads=threads, runs=RUNS if checks else 1)


def _run_scene_and_start_checks(
    planned: Plan | Trajectory,
    out: Path | None,
    background: BackgroundCaseRunner | None,
    lift: bool,
    packings: int,
    progress: bool,
) -> tuple[Trajectory, SceneChecks | None]:
    """Start the checks, then simulate unless a run is given; return the run and its checks."""
    from granular.run.trajectory import Trajectory

    if not isinstance(planned, Trajectory):
        planned.check_arguments()
        settings = {"dt": planned.dt, "t_end": planned.t_end, "method": planned.method}
        further = (
            None if background is None else SceneChecks(background, planned.scene, settings, lift, packings)
        )
        run = run_plan(planned, out, progress)
        return run, further if run.complete else None
    if background is None or not planned.complete:
        return planned, None
    settings = {name: planned.settings()[name] for name in ("dt", "method")}
    settings["t_end"] = end_time_of_open_run(planned)
    return planned, SceneChecks(background, planned.scene, settings, lift, packings)


def _check_arguments(laws: Sequence[str | Law] | None, mass: float | None) -> None:
    if laws is not None and not laws:
        raise InputError("the argument laws is empty; give one or more laws")
    if isinstance(laws, str) or (laws is not None and not isinstance(laws, Iterable)):
        raise InputError(f"laws = {quote(laws)}; give a list of names, equations or laws")
    for law in laws or ():
        if isinstance(law, str) and "'" not in law and "=" not in law and law not in FORCE_LAWS:
            law_named(law)
    if mass is not None and (not isinstance(mass, Real) or not 0.0 < float(mass) < math.inf):
        raise InputError(f"mass = {quote(mass)} kg; give a mass above 0")


def _laws_of_one_and_two_modes(
    coordinates: object, laws: Sequence[str | Law] | None, discovery: str | None, drive: str | None
) -> list[Law]:
    """Return the laws of one linear mode and of two linear modes."""
    from reduced_models.laws.two_modes import TWO_MODES

    if coordinates != 2:
        raise InputError(f"coordinates = {quote(coordinates)}; give 1 or 2")
    if laws is not None or discovery is not None or drive is not None:
        raise InputError(
            "coordinates = 2 fits two linear modes to a free decay; remove the arguments laws, discovery "
            "and drive, or set coordinates = 1 and give the equations of two coordinates in laws"
        )
    return [law_named("linear"), TWO_MODES]


def _moving_mass(mass: float | None, record: PistonRecord, run: Trajectory | None) -> float | None:
    """Return the given moving mass [kg], or else the mass of the piston of the run's scene."""
    if mass is not None and record.coordinate_unit == "rad":
        raise InputError(f"mass = {mass:g} kg, but the record is an angle; remove the argument mass")
    if mass is None and run is not None and run.scene.piston is not None:
        return run.scene.piston.mass
    return mass


def _add_check_outcomes(
    result: Identification, run: Trajectory, further: SceneChecks, progress: bool
) -> Identification:
    """Test the laws on a higher lift and other falls; add errors of time step and packing to the results."""
    # Another lift is useful only if there are several laws.
    checks = further.wait_for_outcomes(run, progress)
    comparison, model, figures = result.comparison, result.model_of_figures, result.figures
    own, no_own = result.own, result.no_own
    record, mass = result.record, result.mass
    if checks.lift is not None and len(result.models) > 1:
        # The new ranking may change the best law, which gives the figures.
        comparison = compare_on_further_records(comparison, [checks.lift])
        order = [row.models[0] for row in comparison.rows if row.models]
        model = next((entry for entry in order if entry.at_rest is not None), order[0])
        figures = oscillation_quantities(model, mass)
        own, no_own = backbone_compared_with_law_or_reason(record, order[0])
    duration = float(record.time[-1] - record.time[0])
    figures, parameters, own, failed = add_check_errors(figures, own, model, mass, duration, checks, run)
    notes = tuple(dict.fromkeys((*checks.failures, *failed)))
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
