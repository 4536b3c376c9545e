"""Further runs of a scene: another time step, other random packings, a higher lift, and other falls."""

from __future__ import annotations

import contextlib
import dataclasses
import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.errors import GranularError, InputError, RecordError
from reduced_models.falls.unseen_fall_scores import (
    FALL_LAWS,
    DropScore,
    DropScores,
    fit_law_to_fall,
    score_fitted_laws,
)
from reduced_models.fitting.fit import fit
from reduced_models.fitting.parameter import fixed_height_map_parameters
from reduced_models.fitting.search import compile_fit_ahead
from reduced_models.identification.candidate_laws import LIKELY
from reduced_models.identification.comparison_table import DerivedOscillation
from reduced_models.identification.measured_oscillation import (
    BackboneComparedWithLaw,
    quantities_at_amplitudes,
)
from reduced_models.laws.catalogue import law_named
from reduced_models.models.model import ReducedModel
from reduced_models.models.printed_model import oscillation_quantities
from reduced_models.models.quantities import QuantityWithError, add_step_and_packing_errors
from reduced_models.records.first_guesses import first_guesses
from reduced_models.records.sources import FALL, RECORD, piston_record_columns

if TYPE_CHECKING:
    from granular.linear import MotionFriction
    from granular.linear.equilibrium import Equilibrium
    from granular.run.plan import Plan
    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene
    from granular.studies.sweep import BackgroundCall, BackgroundCase, BackgroundCaseRunner
    from granular.studies.tolerances import Part

PACKINGS = 3
"""Number of random packings that give the spread, including the scene's own."""
LIFT_TIMES = 3.0
"""Ratio of the held-out lift to the scene's lift, large enough to distinguish laws."""
DROPS = (0.4, 0.6, 1.4, 1.8)
"""Ratios of the heights of the other drops to the height of the scene's drop."""
PERIODS = 10.0
"""Duration of falls in periods of small oscillations; after this time the motion is small."""
FEWEST = 100
"""Minimum number of samples of a fall."""
STARTS = 8
"""Number of random starts of a fit to a fall; few suffice without noise and with known start values."""
TITLE = "checks of time step, random packings, lift and falls"
_MINIMUM_FALL = 0.05  # relative to the height after it; a shorter motion does not count as a fall


class CheckRun(NamedTuple):
    """Further run of a scene with some of its keys changed."""

    label: str
    changes: Mapping[str, Any]
    factor: float = 0.0  # for another time step: error of the run's step over the change by the other step


class CheckOutcomes(NamedTuple):
    """Records of further runs of a scene, and scores of laws on falls."""

    step_check: CheckRun | None
    derived: DerivedOscillation | None  # derived values, which replace a run with another step
    runs: tuple[tuple[str, PistonRecord | None], ...]  # runs with another step, then from other packings
    lift: PistonRecord | None
    falls: DropScores | None
    failures: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class SimulateReleaseFromEquilibrium:
    """Function that returns the records of a check run.

    If the run only lets a bed settle, the release is simulated from the exact equilibrium. The stages of the
    release are dictionaries, as in a scene file.
    """

    release: tuple[Mapping[str, Any], ...]
    keep_measure_name: ClassVar[str] = "reduced_models.identification:records_of_rest#1"

    def __call__(self, run: Trajectory) -> Mapping[str, Any]:
        """Return the columns of `piston_record_columns`, after a release if there is one."""
        if not self.release or len(run.scene.protocol) > 1 or not is_rest_stage(run.scene, 0):
            return piston_record_columns(run)
        from granular import equilibrium
        from granular.run.simulation import simulate

        changes = scene_changes_for_release_from_equilibrium(equilibrium(run), self.release)
        after = simulate(
            run.scene.replace(**changes), run.settings()["dt"], method=run.method, progress=False
        )
        return {**piston_record_columns(run), RECORD: piston_record_columns(after)[RECORD]}


def scene_changes_for_release_from_equilibrium(
    rest: Equilibrium, stages: tuple[Mapping[str, Any], ...]
) -> dict[str, Any]:
    """Return the changes of a scene that start its run at an equilibrium."""
    return {
        "arrangement.positions": rest.positions.tolist(),
        "piston.height": rest.piston_height,
        "protocol": list(stages),
    }


def is_rest_stage(scene: Scene, index: int) -> bool:
    """Return whether a stage leaves the piston free until it comes to rest."""
    from granular.protocol.stages import Free

    stage = scene.protocol[index]
    return isinstance(stage, Free) and stage.until == "rest"


def stages_after_initial_rest(scene: Scene) -> tuple[Mapping[str, Any], ...]:
    """Return the stages after the first, as dictionaries; empty if they cannot start from equilibrium."""
    from granular.linear.bed_forces import has_dry_friction

    moves = {"host", "shaking", "bath"} & {effect.key for effect in scene.effects.acting}
    names = [stage.name for stage in scene.protocol]
    if moves or has_dry_friction(scene) or len(names) < 2 or not is_rest_stage(scene, 0):
        return ()
    if scene.output.record not in names[1:]:
        return ()
    return tuple(scene.to_plain()["protocol"][1:])


def equilibrium_after_first_stage(run: Trajectory) -> Equilibrium:
    """Find the equilibrium nearest to the end of a run's first stage."""
    from granular.linear.equilibrium import equilibrium_from
    from granular.run.trajectory import piston_heights_in_frames

    times = run.dataset["frame_time"].values
    frame = int(np.argmin(np.abs(times - run.stages[0].end)))
    positions = run.dataset["position"].values[frame]
    return equilibrium_from(run.scene, positions, piston_heights_in_frames(run.scene, run.dataset)[frame])


def read_part_tolerances_of_source(
    source: Scene | Plan | Trajectory | PistonRecord, parts: Mapping[str, str | float]
) -> tuple[Part, ...]:
    """Read tolerances of the parts of a scene or of a run's scene, which must begin with a rest stage."""
    from granular.linear.bed_forces import check_free_piston
    from granular.studies.tolerances import read_part_tolerances

    if isinstance(source, PistonRecord):
        raise InputError("a record has no parts with tolerances; pass a scene or a run instead of a record")
    given: Any = source
    scene: Scene = getattr(given, "scene", given)
    check_free_piston(scene)
    if not is_rest_stage(scene, 0):
        raise InputError(
            f"the scene {scene.name!r} does not begin with a rest stage, but effects of tolerances are "
            "computed at rest; give its first stage until = 'rest', or use the command tolerances"
        )
    return read_part_tolerances(scene, parts)


def dry_friction_of_run(run: Trajectory) -> MotionFriction | None:
    """Dry friction along the piston's motion, from the bed at its first equilibrium; None if unknown."""
    from granular.linear.friction import has_friction, motion_friction

    if not has_friction(run.scene) or not is_rest_stage(run.scene, 0):
        return None
    try:
        return motion_friction(equilibrium_after_first_stage(run))
    except GranularError:  # no equilibrium nearby, or no oscillation of the piston
        return None


def derive_oscillation(run: Trajectory, rest: Equilibrium) -> DerivedOscillation:
    """Derive a bed's small oscillations, and their error due to the run's time step."""
    from granular.linear import piston_roots, root_of_steps

    exact = piston_roots(rest)[0]
    errors = None
    with contextlib.suppress(InputError):  # variable steps have no discrete root
        root = root_of_steps(rest, exact, run.settings()["longest_step"], run.method)
        ratio = -root.real / abs(root)
        of_damping = ratio / exact.damping_ratio - 1.0 if exact.damping_ratio > 0.0 else 0.0
        errors = abs(abs(root) / abs(exact.s) - 1.0), abs(of_damping)
    assert rest.piston_height is not None
    return DerivedOscillation(rest.piston_height, exact.frequency, exact.damping_ratio, errors)


def compile_fits_ahead(background: BackgroundCaseRunner, scene: Scene, starts: int) -> None:
    """Compile the code of the fits in the background while the scene is simulated."""
    falls = FALL_LAWS if begins_with_fall(scene) else ()
    for name, count in [*((name, starts) for name in LIKELY), *((name, STARTS) for name in falls)]:
        background.submit_call(compile_fit_ahead, law_named(name), count)


class SceneChecks:
    """Checks of a scene's run, started before it and computed in parallel."""

    def __init__(
        self,
        background: BackgroundCaseRunner,
        scene: Scene,
        settings: Mapping[str, Any],
        lift: bool,
        packings: int = PACKINGS,
    ) -> None:
        self._background, self._scene, self._settings = background, scene, settings
        self._release = stages_after_initial_rest(scene)
        self._fall: PistonRecord | None = None
        self._fall_fits: list[BackgroundCall[DropScore]] = []
        self._starts = self._submit_check_runs(random_packing_check_runs(scene, packings - 1))
        self._higher_lift = higher_lift_check_run(scene) if lift else None
        self._lift = [] if self._release else self._start_higher_lift_run({})

    def _start_higher_lift_run(self, begin: Mapping[str, Any]) -> list[tuple[CheckRun, BackgroundCase]]:
        check = self._higher_lift
        return (
            []
            if check is None
            else self._submit_check_runs([CheckRun(check.label, {**begin, **check.changes})])
        )

    def _submit_check_runs(self, checks: Sequence[CheckRun]) -> list[tuple[CheckRun, BackgroundCase]]:
        cases = [check.changes for check in checks]
        started = self._background.submit_cases(self._scene, cases, self._settings)
        return list(zip(checks, started, strict=True))

    def _derive_oscillation_and_failures(
        self, run: Trajectory
    ) -> tuple[DerivedOscillation | None, list[str]]:
        """Start the higher lift from the bed's equilibrium; return derived oscillations and failure texts."""
        begin, derived, failures = {}, None, []
        if self._release:
            try:
                rest = equilibrium_after_first_stage(run)
                derived = derive_oscillation(run, rest)
                begin = scene_changes_for_release_from_equilibrium(rest, self._release)
            except GranularError as error:
                failures.append(_failure_text("equilibrium", str(error)))
            self._lift = self._start_higher_lift_run(begin)
        return derived, failures

    def begin_fall_fits(self, run: Trajectory) -> None:
        """Start to fit the laws of a whole fall to the fall in this run."""
        self._fall = first_fall_record(run)
        if self._fall is not None:
            fits = [(law, self._fall, self._scene, STARTS) for law in FALL_LAWS]
            # A background process finishes these calls before the caller starts the other falls.
            half = len(fits) // 2
            self._fall_fits = [
                self._background.submit_call(fit_law_to_fall, *args, in_caller=k >= half)
                for k, args in enumerate(fits)
            ]

    def wait_for_outcomes(self, run: Trajectory, progress: bool) -> CheckOutcomes:
        """Start the checks that need the scene's run, wait for all checks, and score the laws of the fall."""
        derived, failures = self._derive_oscillation_and_failures(run)
        step_check = choose_step_check_run(run) if derived is None or derived.step_errors is None else None
        other = [] if step_check is None else self._submit_check_runs([step_check])
        fall = self._fall
        drops = self._submit_check_runs([] if fall is None else other_drop_check_runs(run, fall))
        fits = [call.result() for call in reversed(self._fall_fits)][::-1]
        order = [*other, *self._starts, *self._lift, *drops]
        outcomes = self._background.wait_for_outcomes([case for _, case in order], TITLE, progress)
        every = []
        for (check, _), outcome in zip(order, outcomes, strict=True):
            try:
                if outcome.error is not None:
                    raise RecordError(" ".join(outcome.error.split()))
                columns = outcome.figures.items()
                every.append({name: PistonRecord.from_columns(values) for name, values in columns})
            except RecordError as cause:
                every.append({})
                failures.append(_failure_text(check.label, str(cause)))
        motions = iter(every)
        changed, starts, lifts, others = (
            [next(motions) for _ in group] for group in (other, self._starts, self._lift, drops)
        )
        scores = None
        if fall is not None:
            duration = float(fall.time[-1] - fall.time[0])
            unseen = {
                check.label: motion[RECORD]
                for (check, _), motion in zip(drops, others, strict=True)
                if motion
            }
            # As many falls for any number of packings, since the verdict is their median.
            for (check, _), motion in zip(self._starts[: PACKINGS - 1], starts, strict=False):
                if motion:
                    again = motion.get(FALL, motion[RECORD])
                    unseen[check.label.removeprefix("random ")] = _cut_record_to_duration(again, duration)
            try:
                scores = score_fitted_laws(fall, fits, unseen, _height_after_fall(run))
            except InputError as cause:
                failures.append(_failure_text("other falls", str(cause)))
        return CheckOutcomes(
            step_check=step_check,
            derived=derived,
            runs=tuple(
                (check.label, motion.get(RECORD))
                for (check, _), motion in zip([*other, *self._starts], [*changed, *starts], strict=True)
            ),
            lift=next((motion[RECORD] for motion in lifts if motion), None),
            falls=scores,
            failures=tuple(failures),
        )


def _failure_text(label: str, cause: str) -> str:
    return f"the check with {label} failed: {cause}"


def add_check_errors(
    figures: Sequence[QuantityWithError],
    measured: BackboneComparedWithLaw | None,
    model: ReducedModel,
    mass: float | None,
    duration: float,
    outcomes: CheckOutcomes,
    run: Trajectory,
) -> tuple[
    tuple[QuantityWithError, ...], tuple[QuantityWithError, ...], BackboneComparedWithLaw | None, list[str]
]:
    """Add errors due to time step and random packing to results, parameters and measured oscillation."""
    from granular.studies.packing_spread import expected_packing_spread

    # The same law over the same duration [s], so that only the run differs.
    check, derived = outcomes.step_check, outcomes.derived
    spread, seconds = expected_packing_spread(run.scene), run.settings()["seconds"]
    every = (*figures, *model.parameter_quantities())
    refitted: list[Sequence[QuantityWithError] | None] = []
    read: list[Sequence[QuantityWithError] | None] = []
    failed = []
    for what, swing in outcomes.runs:
        motion = None if swing is None else _cut_record_to_duration(swing, duration)
        try:
            refitted.append(
                None if motion is None else _fit_law_and_derive_quantities(motion, model, mass, every)
            )
        except GranularError as cause:
            refitted.append(None)
            failed.append(_failure_text(what, str(cause)))
        both = None if motion is None or measured is None else quantities_at_amplitudes(motion, measured)
        read.append(both)

    def add_step_and_spread_errors(
        known: Sequence[QuantityWithError], others: Sequence[Sequence[QuantityWithError] | None]
    ) -> tuple[QuantityWithError, ...]:
        if check is not None:
            changed, *starts = others
            pairs = () if changed is None else zip(known, changed, strict=True)
            changes = [check.factor * abs(other.value - figure.value) for figure, other in pairs]
            return add_step_and_packing_errors(
                known, changes or None, *starts, spread=spread, seconds=seconds
            )
        assert derived is not None
        steps = [derived.step_error(figure) for figure in known]
        return add_step_and_packing_errors(known, steps, *others, spread=spread, seconds=seconds)

    if measured is not None:
        measured = dataclasses.replace(measured, figures=add_step_and_spread_errors(measured.figures, read))
    every = add_step_and_spread_errors(every, refitted)
    return every[: len(figures)], every[len(figures) :], measured, failed


def _cut_record_to_duration(record: PistonRecord, duration: float) -> PistonRecord:
    start = float(record.time[0])
    return record.between(start, start + duration * (1.0 + 1e-9))


def _fit_law_and_derive_quantities(
    record: PistonRecord, model: ReducedModel, mass: float | None, reference: Sequence[QuantityWithError]
) -> tuple[QuantityWithError, ...]:
    """Fit the model's law to a further run's record; return the reference quantities with the new values."""
    with warnings.catch_warnings(action="ignore"):
        again = fit(
            record,
            model.law,
            starts=model.quality.starts,
            test_fraction=0.0,
            parameters=fixed_height_map_parameters(model),
        )
    figures = (*oscillation_quantities(again, mass), *again.parameter_quantities())
    if [figure.symbol for figure in figures] != [figure.symbol for figure in reference]:
        raise InputError("the fit of the further run does not give the same quantities")
    return figures


def choose_step_check_run(run: Trajectory) -> CheckRun:
    """Return a further run with twice the time step, or with half of it if twice is too coarse."""
    # Richardson extrapolation (Hairer, Norsett & Wanner 1993, Solving Ordinary Differential Equations I, sec.
    # II.4): halving the step changes the result by 1 - 2^-p of the error. For twice the step the full change
    # is taken as the error, a bound also if the bed packs differently and no order holds.
    from granular.run.plan import can_run, scaled_time_step_setting
    from granular.run.work_precision import MAX_RESOLVED_PRODUCT

    settings = run.settings()
    twice, half = (scaled_time_step_setting(settings["dt"], by) for by in (2.0, 0.5))
    is_resolved = 2.0 * settings["step_times_highest_frequency"] <= MAX_RESOLVED_PRODUCT
    if is_resolved and can_run(run.scene, twice, run.method):
        return CheckRun("twice the time step", {"dt": twice}, 1.0)
    power = 2.0**run.method.order
    return CheckRun("half the time step", {"dt": half}, power / (power - 1.0))


def random_packing_check_runs(scene: Scene, count: int = PACKINGS - 1) -> list[CheckRun]:
    """Return runs from other random packings; beds that settle are released from equilibrium."""
    from granular.linear.equilibrium import COARSE_REST, scene_changes_to_end_at_rest

    first = scene.arrangement.seed + 1
    changes = scene_changes_to_end_at_rest(scene, COARSE_REST) if stages_after_initial_rest(scene) else {}
    return [
        CheckRun(f"random start {seed}", {"arrangement.seed": seed, **changes})
        for seed in range(first, first + count)
    ]


def higher_lift_check_run(scene: Scene) -> CheckRun | None:
    """Return a run with a lift three times as high; None if the scene has no lift or several."""
    from granular.protocol.stages import Lift

    lifts = [stage for stage in scene.protocol if isinstance(stage, Lift)]
    if len(lifts) != 1:
        return None
    return CheckRun("a lift three times as high", {f"protocol.{lifts[0].name}.by": LIFT_TIMES * lifts[0].by})


def end_time_of_open_run(run: Trajectory) -> float | None:
    """Return the end time [s] of a run whose last stage has no end condition; None otherwise."""
    height = 1.0 if run.scene.piston is None else run.scene.piston.height
    if run.scene.protocol[-1].maximum_duration(height) is not None:
        return None
    return float(run.dataset["time"].values[-1])


def begins_with_fall(scene: Scene) -> bool:
    """Return whether the piston falls freely in a scene's first stage."""
    from granular.protocol.stages import Free

    falls = scene.piston is not None and scene.effects.gravity is not None
    return falls and bool(scene.protocol) and isinstance(scene.protocol[0], Free)


def first_fall_record(run: Trajectory) -> PistonRecord | None:
    """Record of the fall at the start of a run; None without a fall."""
    if not begins_with_fall(run.scene):
        return None
    try:
        record = run.piston(run.scene.protocol[0].name)
        total = run.piston()
        period = first_guesses(total.time, total.height).period
    except RecordError:
        return None
    start = float(record.time[0])
    record = record.between(start, min(float(record.time[-1]), start + PERIODS * period))
    rest = _height_after_fall(run)
    falls = record.height[0] - rest > _MINIMUM_FALL * rest
    return record if falls and len(record) >= FEWEST else None


def _height_after_fall(run: Trajectory) -> float:
    """Return the height [m] at which the first stage of a run ends."""
    return run.stage(run.scene.protocol[0].name).height


def other_drop_check_runs(run: Trajectory, fall: PistonRecord) -> list[CheckRun]:
    """Return runs of only the fall, from other piston heights under which the grains fit."""
    scene = run.scene
    assert scene.piston is not None
    first = scene.protocol[0]
    rest, height = _height_after_fall(run), scene.piston.height
    grid = scene.arrangement.height
    stage = {"kind": "free", "name": first.name, "duration": float(fall.time[-1] - fall.time[0])}
    alone = {"protocol": [stage], "output.record": first.name}
    drops = []
    for ratio in DROPS:
        other = rest + ratio * (height - rest)
        below = None if grid is None else other - (height - grid)
        changes = {**alone, "piston.height": other, "arrangement.height": below}
        with contextlib.suppress(GranularError):  # grains may not fit under a lower piston
            scene.replace(**changes)
            drops.append(CheckRun(f"from {1e3 * other:.0f} mm", changes))
    return drops
