"""Settings that reach a tolerance in the least time, for `simulate` and for the command line."""

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
    candidate_settings,
    compare_with_references,
    reference_setting,
    scenes_with_other_seeds,
)
from validation.measured_quantities import MeasuredQuantity, quantity_named
from validation.report_tasks import PlainData
from validation.work_precision_result import (
    AdvisedSetting,
    SolverSettings,
    WorkPrecision,
    WorkPrecisionPoint,
    accurate_points,
    advise_setting,
    duration_text,
    points_without_clear_error,
)

SEEDS = 4
"""Further starts of a scene that has random ones: five show a scatter to a third of itself."""

# A family is given up, or not begun, if its next step costs this many times the best setting so far. 1 would
# do if times were exact; the rest is room for their scatter.
HOPELESS = 2.0

REFERENCE = "stormer-verlet"
REFERENCES = (*STEPS[2:], "auto/16")
"""Method and steps that a bed with random starts is measured against, the longest first: what it
comes to scatters too much for more to pay."""

APART = 2
"""Halvings of a step before it is a reference: its error is a sixteenth then."""


@dataclasses.dataclass(frozen=True)
class Recommendation(PlainData):
    """A setting that reaches a tolerance, by one run or by many starts.

    Attributes
    ----------
    scene, quantity : str
    tolerance, error : float
        What was asked for, and what was measured.
    seconds : float
        What one run takes.
    keywords : dict
        For ``simulate(scene.replace(**found.changes), **found.keywords)``.
    changes : dict
        Keys of the scene.
    study : WorkPrecision
        All settings that were tried.
    doubt : float
        Standard error of the error.
    starts : int
        How many random starts to average over: 1 unless the scatter of the starts forbids a single
        run to be that accurate.
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
        """True where the starts scatter by too much for a single run to reach the tolerance."""
        return self.tolerance < FLOORS * self.study.floor

    @property
    def command(self) -> str:
        """Text of the command line that runs the scene with this setting."""
        words = ["python", "-m", "granular", "run", self.scene]
        for key, value in self.changes.items():
            words += ["--set", f"{key}={value}"]
        words += ["--dt", str(self.keywords["dt"]), "--method", self.keywords["method"]]
        return shlex.join(words)

    def __str__(self) -> str:
        what = f"{self.quantity} of {self.scene} to {self.tolerance:g}: "
        error = f"error {self.error:.2g}" + (f" +- {self.doubt:.1g}" if self.doubt else "")
        if not self.needs_more_starts:
            return f"{what}{error} in {self.seconds:.3g} s\n  {self.command}"
        price = duration_text(self.starts * self.seconds)
        return (
            f"{what}any of these: the starts scatter by {self.study.floor:.2g}, which no step "
            f"corrects; the mean of {self.starts:.3g} starts (arrangement.seed) costs {price}\n"
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
    """Return the setting that gives a quantity to a tolerance in the least time.

    What was measured is kept among the user's caches, where ``granular.simulate(..., accuracy=)`` finds it.
    Each method is tried from long steps to short ones, until two in turn are accurate, or the next
    would cost far more than what was found. Where the scene has random starts, each setting is run
    from the same few of them: an error is then a mean deviation with its standard error, and a
    tolerance that the scatter of the starts forbids is answered by how many starts reach it.

    Parameters
    ----------
    scene : Scene
        Scene to run.
    quantity : str or MeasuredQuantity
        One of `validation.measured_quantities.QUANTITIES`, or one's own.
    tolerance : float
        Error that is allowed, above 0; relative, but for the positions (in D) and the energy (over the
        energy turned over).
    until : float, optional
        Stop each run at this time [s]; the whole protocol without.
    seeds : int
        Number of further random starts, 0 or more.
    progress : bool
        Show which setting is being run.

    Returns
    -------
    Recommendation
        Setting with the wall time of a run [s], its error (as the tolerance), and the number of starts.

    Raises
    ------
    InputError
        If the tolerance is not above 0, ``seeds`` is below 0, the quantity is unknown, no reference can be
        run on the scene, or no setting tried reaches the tolerance.
    RunError
        If the reference fails.
    """
    chosen = quantity_named(quantity)
    if not 0.0 < tolerance < math.inf:
        raise InputError(f"tolerance = {tolerance!r}; give an error above 0, such as 0.01")
    if seeds < 0:
        raise InputError(f"seeds = {seeds}; give a number of further starts, 0 or more")
    scenes = scenes_with_other_seeds(scene, seeds)
    # The mean of a quantity over random starts scatters.
    if chosen.exact is None and not chosen.differs_by_start and len(scenes) > 1:
        study = _study_by_halving(scenes, chosen, tolerance, until, progress)
    else:
        reference = None if chosen.exact is not None else reference_setting(scene)
        study = _measure_until_decided(
            scenes, chosen, candidate_settings(scene), reference, tolerance, until, progress
        )
    store_measured_scene(scene, chosen.name, until, _measured_scene(scene, study, len(scenes)))
    return recommend_from_study(study, tolerance)


def _measured_scene(scene: Scene, study: WorkPrecision, starts: int) -> SceneWorkPrecision:
    """Make a row of the table that `granular.plan` looks in."""
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
    # Of the scene itself: its bounds need no margin.
    return SceneWorkPrecision(
        scene.name, kind, grains, starts, study.reference, floors, entries, today, margin=1.0
    )


def _study_by_halving(
    scenes: Sequence[Scene], quantity: MeasuredQuantity, tolerance: float, until: float | None, progress: bool
) -> WorkPrecision:
    """Study against the longest reference step that tells whether a tolerance is met."""
    # The step halved `APART` times to give a reference must be accurate enough itself: by second order the
    # reference then errs by a fifteenth of the tolerance at most.
    study = None
    steps = (*STEPS, REFERENCES[-1])
    for dt in REFERENCES:
        coarse = steps[: steps.index(dt) - APART + 1]
        settings = [candidate for candidate in candidate_settings(scenes[0]) if candidate.dt in coarse]
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
            f"scene {scenes[0].name!r} cannot be run by {REFERENCE} at any step of {steps[0]} to "
            f"{steps[-1]}, against which settings are measured; give seeds=0"
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
    """Points that it takes to choose, family by family."""
    from granular.shared.progress_bars import progress_bar

    with progress_bar(desc="reference", wanted=progress, leave=False, unit="setting") as bar:
        comparison = compare_with_references(scenes, [quantity], [reference], until)
        (truth,) = comparison.truth
        tried: list[WorkPrecisionPoint] = []
        for family in dict.fromkeys(setting.family for setting in settings):
            own: list[WorkPrecisionPoint] = []
            for setting in (setting for setting in settings if setting.family == family):
                best = advise_setting(tried + own, truth.floor, tolerance)
                if _finest_points_suffice(own, truth.floor, tolerance):
                    break
                if _too_dear(setting, tried + own, best):
                    break
                bar.set_description(f"{family}, {setting.dt}, against {truth.words}")
                own += filter(None, comparison.points(setting, REPEATS))
                bar.update()
            tried += own
    return comparison.studies([[point] for point in tried])[0]


def _finest_points_suffice(
    points: Sequence[WorkPrecisionPoint], floor: float, tolerance: float, count: int = 2
) -> bool:
    """Tell if the finest points of a family are good enough."""
    last = points[-count:]
    if tolerance < FLOORS * floor:
        return len(points_without_clear_error(last)) == count
    return len(accurate_points(last, tolerance)) == count


def _too_dear(setting: SolverSettings, tried: Sequence[WorkPrecisionPoint], best: AdvisedSetting) -> bool:
    """Tell if a setting must cost far more than the best one so far."""
    # By its force calls: the time of a run is that of its steps times those of each.
    known = [latest for latest in tried if not latest.has_failed and latest.setting.dt in STEPS]
    if not known or best.point is None or setting.dt not in STEPS:
        return False
    calls = METHODS[setting.method].force_evaluations_per_step
    last = known[-1]
    shorter = STEPS.index(setting.dt) - STEPS.index(str(last.setting.dt))
    seconds = last.seconds * calls / METHODS[last.setting.method].force_evaluations_per_step * 2.0**shorter
    return seconds > HOPELESS * best.point.seconds


def recommend_from_study(study: WorkPrecision, tolerance: float) -> Recommendation:
    """Return the setting that a study recommends for a tolerance."""
    advised = study.advise(tolerance)
    if advised.point is None:
        front = study.pareto_front()
        best = f"{front[-1].error:.2g}" if front else "none"
        raise InputError(
            f"tolerance = {tolerance:g} for the {study.quantity} is reached by no setting tried; "
            f"the least error is {best}: give a larger tolerance or other settings"
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
