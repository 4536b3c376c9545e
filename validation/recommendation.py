"""Find the setting that reaches a tolerance in the shortest time, for `simulate` and the command line."""

from __future__ import annotations

import dataclasses
import datetime
import math
import shlex
from collections.abc import Sequence
from typing import Any

from granular.methods import METHODS
from granular.run.plan import parse_time_step
from granular.run.work_precision import (
    FLOORS,
    SceneWorkPrecision,
    WorkPrecisionEntry,
    damping_kind,
    store_measured_scene,
)
from granular.scene.scene import Scene
from granular.shared.errors import InputError
from validation.accuracy_cost import (
    REPEATS,
    STEPS,
    choose_reference_setting,
    scenes_with_other_seeds,
    scenes_with_reference_values,
    settings_to_try,
)
from validation.measured_quantities import MeasuredQuantity, quantity_named
from validation.report_tasks import PlainData
from validation.work_precision_result import (
    AdvisedSetting,
    SolverSettings,
    WorkPrecision,
    WorkPrecisionPoint,
    accurate_points,
    advise_setting_and_averaging,
    duration_text,
    points_without_clear_error,
)

SEEDS = 4
"""Number of further random initial states of a scene; five states give the scatter to within a third."""

# A family is abandoned, or not started, if its next step costs this many times the best setting so far. With
# exact times a factor of 1 would be enough; the margin allows for their scatter.
HOPELESS = 2.0

REFERENCE = "stormer-verlet"
REFERENCES = (*STEPS[2:], "auto/16")
"""Steps of the reference for a bed with random initial states, longest first. The results of such a bed
scatter so much that a finer reference would be useless."""

APART = 2
"""Number of halvings from a step to its reference, whose error is then a sixteenth as large."""


@dataclasses.dataclass(frozen=True)
class Recommendation(PlainData):
    """A setting that reaches a tolerance, in a single run or in the mean over many random initial states.

    Attributes
    ----------
    scene, quantity : str
        Names of the scene and of the quantity.
    tolerance, error : float
        Requested and measured error.
    seconds : float
        Wall time of one run [s].
    keywords : dict
        Keyword arguments for ``simulate(scene.replace(**found.changes), **found.keywords)``.
    changes : dict
        Changes to keys of the scene.
    study : WorkPrecision
        All settings that were tried.
    doubt : float
        Standard error of ``error``.
    starts : int
        Number of random initial states to average over; more than 1 if the scatter between them exceeds the
        tolerance.
    """

    scene: str
    quantity: str
    tolerance: float
    error: float
    seconds: float
    keywords: dict[str, Any]
    changes: dict[str, Any]
    study: WorkPrecision
    doubt: float = 0.0
    starts: int = 1

    @property
    def needs_more_starts(self) -> bool:
        """True if the scatter between initial states prevents a single run from reaching the tolerance."""
        return self.tolerance < FLOORS * self.study.floor

    @property
    def command(self) -> str:
        """Command line that runs the scene with this setting."""
        words = ["python", "-m", "granular", "run", self.scene]
        for key, value in self.changes.items():
            words += ["--set", f"{key}={value}"]
        words += ["--dt", str(self.keywords["dt"]), "--method", self.keywords["method"]]
        return shlex.join(words)

    def __str__(self) -> str:
        subject = f"{self.quantity} of {self.scene} to {self.tolerance:g}: "
        error = f"error {self.error:.2g}" + (f" +- {self.doubt:.1g}" if self.doubt else "")
        if not self.needs_more_starts:
            return f"{subject}{error} in {self.seconds:.3g} s\n  {self.command}"
        price = duration_text(self.starts * self.seconds)
        return (
            f"{subject}single runs scatter by {self.study.floor:.2g} over the starts, which no time step "
            f"reduces; the mean of {self.starts:.3g} starts (arrangement.seed) takes {price}\n"
            f"  {self.command}    ({error} in {self.seconds:.3g} s)"
        )

    def to_plain(self) -> dict[str, Any]:
        """Return the recommendation as plain data, with its command."""
        return super().to_plain() | {
            "command": self.command,
            "floor": self.study.floor,
            "below_floor": self.needs_more_starts,
        }


def recommend_settings(
    scene: Scene,
    quantity: str | MeasuredQuantity,
    tolerance: float,
    until: float | None = None,
    seeds: int = SEEDS,
    progress: bool = False,
) -> Recommendation:
    """Return the fastest setting that gives a quantity within a tolerance.

    Measured costs are stored in the user's cache, and ``granular.simulate(..., accuracy=)`` uses them. Each
    method is tried from long to short steps, until two successive steps are accurate, or the next step would
    cost far more than the best setting. If the scene has random initial states (starts), each setting is run
    from the same few starts. The error is then a mean deviation with its standard error. If the scatter
    between starts exceeds the tolerance, the result gives the number of starts over which to average.

    Parameters
    ----------
    scene : Scene
        Scene to run.
    quantity : str or MeasuredQuantity
        Name of one of `validation.measured_quantities.QUANTITIES`, or a custom quantity.
    tolerance : float
        Allowed error, above 0: relative, except for positions (in D) and the energy (divided by the
        energy turned over).
    until : float, optional
        Stop each run at this time [s]. Default: the end of the protocol.
    seeds : int
        Number of further random initial states, 0 or more.
    progress : bool
        Show the setting that is being run.

    Returns
    -------
    Recommendation
        Setting with the wall time of a run [s], its error (in the tolerance's unit), and the number of
        starts.

    Raises
    ------
    InputError
        If the tolerance is not above 0, ``seeds`` is below 0, the quantity is unknown, no reference can run
        the scene, or none of the settings reaches the tolerance.
    RunError
        If the reference run fails.
    """
    chosen = quantity_named(quantity)
    if not 0.0 < tolerance < math.inf:
        raise InputError(f"tolerance = {tolerance!r}; give an error above 0, such as 0.01")
    if seeds < 0:
        raise InputError(f"seeds = {seeds}; give a number of further starts, 0 or more")
    scenes = scenes_with_other_seeds(scene, seeds)
    # The mean of a quantity over random initial states scatters too.
    if chosen.exact is None and not chosen.differs_by_start and len(scenes) > 1:
        study = _study_by_halving(scenes, chosen, tolerance, until, progress)
    else:
        reference = None if chosen.exact is not None else choose_reference_setting(scene)
        study = _measure_until_decided(
            scenes, chosen, settings_to_try(scene), reference, tolerance, until, progress
        )
    store_measured_scene(scene, chosen.name, until, _work_precision_table_row(scene, study, len(scenes)))
    return recommend_from_study(study, tolerance)


def _work_precision_table_row(scene: Scene, study: WorkPrecision, starts: int) -> SceneWorkPrecision:
    """Return a row of the table of measured costs, which `granular.plan` uses."""
    name, today = study.quantity, datetime.datetime.now(datetime.UTC).date().isoformat()
    entries = tuple(
        WorkPrecisionEntry(
            point.setting.method,
            str(point.setting.dt),
            parse_time_step(point.setting.dt, scene).step_times_frequency,
            point.frequency,
            point.seconds,
            {name: point.upper_error_bound},
            [name] * (point.error > 2.0 * point.doubt),
        )
        for point in study.points
        if not point.has_failed
    )
    kind, grains, floors = damping_kind(scene), scene.grains.count, {name: study.floor}
    # The bounds were measured in this scene, so they need no margin.
    return SceneWorkPrecision(
        scene.name, kind, grains, starts, study.reference, floors, entries, today, margin=1.0
    )


def _study_by_halving(
    scenes: Sequence[Scene], quantity: MeasuredQuantity, tolerance: float, until: float | None, progress: bool
) -> WorkPrecision:
    """Study settings against a reference whose step is the longest one fine enough for the tolerance."""
    # The step that is halved `APART` times to give the reference must itself be accurate enough: at second
    # order the error of the reference is then a fifteenth of the tolerance at most.
    study = None
    steps = (*STEPS, REFERENCES[-1])
    for dt in REFERENCES:
        coarse = steps[: steps.index(dt) - APART + 1]
        settings = [candidate for candidate in settings_to_try(scenes[0]) if candidate.dt in coarse]
        if not any(setting.method == REFERENCE for setting in settings):
            continue
        study = _measure_until_decided(
            scenes, quantity, settings, SolverSettings(REFERENCE, dt), tolerance, until, progress
        )
        own = [point for point in study.points if point.setting.method == REFERENCE]
        if _finest_points_suffice(own, study.floor, tolerance, 1):
            break
    if study is None:
        raise InputError(
            f"scene {scenes[0].name!r} cannot be run by the reference {REFERENCE} at any step from "
            f"{steps[0]} to {steps[-1]}; give seeds=0"
        )
    return study


def _measure_until_decided(
    scenes: Sequence[Scene],
    quantity: MeasuredQuantity,
    settings: Sequence[SolverSettings],
    reference: SolverSettings | None,
    tolerance: float,
    until: float | None,
    progress: bool,
) -> WorkPrecision:
    """Measure settings, one method after the other, until the fastest accurate setting is certain."""
    from granular.shared.progress_bars import progress_bar

    with progress_bar(desc="reference", wanted=progress, leave=False, unit="setting") as bar:
        comparison = scenes_with_reference_values(scenes, [quantity], [reference], until)
        (truth,) = comparison.truth
        tried: list[WorkPrecisionPoint] = []
        for family in dict.fromkeys(setting.family for setting in settings):
            own: list[WorkPrecisionPoint] = []
            for setting in (setting for setting in settings if setting.family == family):
                best = advise_setting_and_averaging(tried + own, truth.floor, tolerance)
                if _finest_points_suffice(own, truth.floor, tolerance):
                    break
                if _must_cost_far_more_than_best(setting, tried + own, best):
                    break
                bar.set_description(f"{family}, {setting.dt}, against {truth.label}")
                own += filter(None, comparison.measure_points(setting, REPEATS))
                bar.update()
            tried += own
    return comparison.studies([[point] for point in tried])[0]


def _finest_points_suffice(
    points: Sequence[WorkPrecisionPoint], floor: float, tolerance: float, count: int = 2
) -> bool:
    """Return True if the ``count`` finest settings of a family are all accurate enough."""
    last = points[-count:]
    if tolerance < FLOORS * floor:
        return len(points_without_clear_error(last)) == count
    return len(accurate_points(last, tolerance)) == count


def _must_cost_far_more_than_best(
    setting: SolverSettings, tried: Sequence[WorkPrecisionPoint], best: AdvisedSetting
) -> bool:
    """Return True if a setting must take far longer than the best setting so far."""
    # The estimate uses force calls: the time of a run is proportional to steps times force calls per step.
    known = [latest for latest in tried if not latest.has_failed and latest.setting.dt in STEPS]
    if not known or best.point is None or setting.dt not in STEPS:
        return False
    calls = METHODS[setting.method].force_evaluations_per_step
    last = known[-1]
    shorter = STEPS.index(setting.dt) - STEPS.index(str(last.setting.dt))
    seconds = last.seconds * calls / METHODS[last.setting.method].force_evaluations_per_step * 2.0**shorter
    return seconds > HOPELESS * best.point.seconds


def recommend_from_study(study: WorkPrecision, tolerance: float) -> Recommendation:
    """Return the recommendation of a study for a tolerance."""
    advised = study.advise(tolerance)
    if advised.point is None:
        front = study.pareto_front()
        best = f"{front[-1].error:.2g}" if front else "none"
        raise InputError(
            f"tolerance = {tolerance:g} for the {study.quantity} is not reached by any setting tried; "
            f"the smallest error is {best}; give a larger tolerance or other settings"
        )
    setting = advised.point.setting
    return Recommendation(
        study.scene,
        study.quantity,
        tolerance,
        advised.point.error,
        advised.point.seconds,
        {"dt": setting.dt, "method": setting.method},
        dict(setting.changes),
        study,
        advised.point.doubt,
        advised.starts,
    )
