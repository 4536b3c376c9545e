"""Checks of a simulated bed: release from exact equilibrium, choice of pair sum and time step, and
their cost.
"""

import importlib
from concurrent.futures import Executor, Future
from typing import Any

import numpy as np
import pytest

from granular import Plan, Scene, Trajectory, damper, load_scene, plan, simulate
from granular.linear import piston_roots, root_of_steps
from granular.linear.equilibrium import COARSE_REST, scene_changes_to_end_at_rest
from granular.records.record import PistonRecord
from granular.run.work_precision import work_precision_text
from granular.studies.cases import Case
from reduced_models import IdentifyOptions, design, fit, identify
from reduced_models.identification.pictures import checked_work_precision_text
from reduced_models.identification.scene_checks import (
    SimulateReleaseFromEquilibrium,
    derive_oscillation,
    equilibrium_after_first_stage,
    scene_changes_for_release_from_equilibrium,
    stages_after_initial_rest,
)
from reduced_models.models.quantities import DAMPING_RATIO, QuantityWithError
from reduced_models.records.sources import FALL, RECORD


@pytest.fixture(scope="module")
def scene(small_damper: Scene) -> Scene:
    return small_damper.replace(**{"protocol.release.duration": 1.0, "effects.drag.coefficient": 0.5})


@pytest.fixture(scope="module")
def run(scene: Scene) -> Trajectory:
    return simulate(scene, progress=False)


def test_a_release_from_equilibrium_agrees_with_the_release_of_the_run(scene: Scene, run: Trajectory) -> None:
    """The run settles to within 1e-4 D of equilibrium, and the motions agree as closely."""
    stages = stages_after_initial_rest(scene)
    settled = simulate(scene.replace(**scene_changes_to_end_at_rest(scene, COARSE_REST)), progress=False)
    assert settled.stages[-1].end < run.stages[0].end
    records = {
        name: PistonRecord.from_columns(columns)
        for name, columns in SimulateReleaseFromEquilibrium(stages)(settled).items()
    }
    assert len(records[FALL].time) == len(settled.piston().time)
    own, other = run.piston("release"), records[RECORD]
    later = np.interp(own.time - own.time[0], other.time - other.time[0], other.height)
    assert np.abs(later - own.height).max() < 2e-4 * scene.grains.species[0].diameter


def test_results_from_the_derived_law_agree_with_a_fit_to_a_small_release(
    scene: Scene, run: Trajectory
) -> None:
    rest = equilibrium_after_first_stage(run)
    derived = derive_oscillation(run, rest)
    stages = [dict(stage) for stage in stages_after_initial_rest(scene)]
    stages[0]["by"] = 2e-3 * scene.grains.species[0].diameter
    small = simulate(
        scene.replace(**scene_changes_for_release_from_equilibrium(rest, tuple(stages))),
        "auto/2",
        progress=False,
    )
    model = fit(small.piston("release").between(small.stages[1].start + 0.1, small.stages[1].end), "linear")
    assert 1.0 / model.at_rest.period == pytest.approx(
        derived.frequency * np.sqrt(1 - derived.damping_ratio**2), rel=2e-3
    )
    assert model.at_rest.damping_ratio == pytest.approx(derived.damping_ratio, rel=0.03)
    assert model.at_rest.height == pytest.approx(derived.level, rel=1e-6)
    sizes = [(0.06, 0.0), (7.0, derived.step_errors[1])]
    for name, (value, relative) in zip(("rest", DAMPING_RATIO), sizes, strict=True):
        assert derived.step_error(QuantityWithError(name, name, "", value, {})) == value * relative
    text = derived.text(())
    assert text.startswith(f"f0 {derived.frequency:.5g} Hz, zeta ")


def test_predicted_time_step_error_agrees_with_simulations_at_coarse_steps(run: Trajectory) -> None:
    """The error is predicted from the eigenvalue of one time step. Two runs start in the piston mode."""
    rest = equilibrium_after_first_stage(run)
    exact = piston_roots(rest)[0]
    longest = run.settings()["longest_step"]
    errors = [abs(root_of_steps(rest, exact, longest * by)) / abs(exact.s) - 1.0 for by in (1.0, 2.0)]
    assert errors[1] / errors[0] == pytest.approx(4.0, rel=0.05)


IDENTIFY = importlib.import_module("reduced_models.identification.identify")


class RecordingExecutor(Executor):
    """Stores the submitted scenes without computing."""

    def __init__(self) -> None:
        self.scenes: list[Scene] = []

    def submit(self, _: Any, case: Case, *__: Any, **___: Any) -> Future[Any]:
        self.scenes.append(case.scene)
        return Future()


class StoppedError(RuntimeError):
    """Raised instead of a simulation."""


def summed(
    monkeypatch: pytest.MonkeyPatch, scene: Scene | Plan, checks: bool = True
) -> tuple[str, str, set[str]]:
    """Return the method of pair summation and the step of a scene's run, and the methods of its checks."""
    ran, asked = [], RecordingExecutor()

    def run(chosen: Plan, *_: Any) -> None:
        ran.append((chosen.pair_sum, str(chosen.dt)))
        raise StoppedError

    monkeypatch.setattr(IDENTIFY, "run_plan", run)
    with pytest.raises(StoppedError):
        identify(scene, options=IdentifyOptions(checks=checks, executor=asked), progress=False)
    return *ran[0], {one.pair_method for one in asked.scenes}


def test_a_scene_and_its_checks_use_the_same_pair_sum(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without checks the direct sum is used, since compiling the mesh sum takes longer than it saves."""
    direct = damper().replace(**{"pairs.method": "direct"})
    for scene, checks, wanted in (
        (damper(), True, ("mesh", "auto*4", {"mesh"})),
        (damper(count=300), True, ("direct", "auto*4.43", {"direct"})),
        (damper(count=92), True, ("direct", "auto*2", {"direct"})),
        (plan(damper()), True, ("direct", "auto", {"direct"})),
        (direct, True, ("direct", "auto*4", {"direct"})),
        (damper(), False, ("direct", "auto*4", set())),
    ):
        assert summed(monkeypatch, scene, checks) == wanted


@pytest.mark.parametrize(("grains", "pairs", "dt"), [(368, "direct", "auto*4"), (184, "direct", "auto*1.41")])
def test_a_proposed_damper_is_simulated_with_the_fastest_settings_whose_errors_are_below_the_spread(
    monkeypatch: pytest.MonkeyPatch, grains: int, pairs: str, dt: str
) -> None:
    asked: list[tuple[str, str]] = []

    def sweep(_: Scene, cases: list[dict[str, Any]], dt: str, **__: Any) -> None:
        asked.extend((Scene.from_plain(case).pair_method, dt) for case in cases)
        raise StoppedError

    monkeypatch.setattr(importlib.import_module("reduced_models.designs.design"), "sweep", sweep)
    with pytest.raises(StoppedError):
        design(3.6, 0.15, grains=grains, small_share=0.3, executor=RecordingExecutor(), progress=False)
    assert asked == [(pairs, dt)]


def test_settings_of_an_identification_include_the_check_of_the_time_step_if_one_was_made() -> None:
    run = simulate(load_scene("single-particle"), 1e-4, 0.05, progress=False)
    rest = QuantityWithError("natural frequency", "f0", "Hz", 60.0, {"fit": 0.0})
    text = checked_work_precision_text(run, rest._replace(parts={"step": 1.2e-3}))
    assert "natural frequency to 2e-05 by the step check; half the step: " in text
    scattered = checked_work_precision_text(run, rest._replace(parts={"step": 1.2e-3, "start": 6e-2}))
    assert "spread over packings 0.001" in scattered
    assert "no better because of the spread" in scattered
    assert checked_work_precision_text(run, rest) == work_precision_text(run)
