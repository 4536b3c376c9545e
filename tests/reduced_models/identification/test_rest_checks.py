"""Checks that begin where the bed is at rest."""

from __future__ import annotations

import numpy as np
import pytest

from granular import Scene, Trajectory, simulate
from granular.linear import piston_roots, root_of_steps
from granular.linear.equilibrium import COARSE_REST, settling_changes
from granular.records.record import PistonRecord
from reduced_models import fit
from reduced_models.identification.scene_checks import (
    RecordsOfRest,
    derive_figures,
    release_from,
    release_stages,
    rest_of,
)
from reduced_models.models.quantities import DAMPING_RATIO, QuantityWithError
from reduced_models.records.sources import FALL, RECORD


@pytest.fixture(scope="module")
def scene(small_damper: Scene) -> Scene:
    return small_damper.replace(**{"protocol.release.duration": 1.0, "effects.drag.coefficient": 0.5})


@pytest.fixture(scope="module")
def run(scene: Scene) -> Trajectory:
    return simulate(scene, progress=False)


def test_a_release_from_equilibrium_is_the_release_of_the_run(scene: Scene, run: Trajectory) -> None:
    """The run has come to rest within 1e-4 D, the other release starts from rest: they agree as closely."""
    stages = release_stages(scene)
    settled = simulate(scene.replace(**settling_changes(scene, COARSE_REST)), progress=False)
    assert settled.stages[-1].end < run.stages[0].end
    records = {
        name: PistonRecord.from_columns(columns) for name, columns in RecordsOfRest(stages)(settled).items()
    }
    assert len(records[FALL].time) == len(settled.piston().time)
    own, other = run.piston("release"), records[RECORD]
    later = np.interp(own.time - own.time[0], other.time - other.time[0], other.height)
    assert np.abs(later - own.height).max() < 2e-4 * scene.grains.species[0].diameter


def test_derived_figures_are_those_of_a_fit_to_a_small_release(scene: Scene, run: Trajectory) -> None:
    rest = rest_of(run)
    derived = derive_figures(run, rest)
    stages = [dict(stage) for stage in release_stages(scene)]
    stages[0]["by"] = 2e-3 * scene.grains.species[0].diameter
    small = simulate(scene.replace(**release_from(rest, tuple(stages))), "auto/2", progress=False)
    model = fit(small.piston("release").between(small.stages[1].start + 0.1, small.stages[1].end), "linear")
    assert model.at_rest is not None
    assert 1.0 / model.at_rest.period == pytest.approx(
        derived.frequency * np.sqrt(1 - derived.damping_ratio**2), rel=2e-3
    )
    assert model.at_rest.damping_ratio == pytest.approx(derived.damping_ratio, rel=0.03)
    assert model.at_rest.height == pytest.approx(derived.level, rel=1e-6)
    assert derived.step_errors is not None
    sizes = [(0.06, 0.0), (7.0, derived.step_errors[1])]
    for name, (value, relative) in zip(("rest", DAMPING_RATIO), sizes, strict=True):
        assert derived.step_error(QuantityWithError(name, name, "", value, {})) == value * relative
    text = derived.text(())
    assert text.startswith(f"f0 {derived.frequency:.5g} Hz, zeta ")


def test_the_root_of_a_step_is_that_of_the_motion_by_the_step(run: Trajectory) -> None:
    """Two runs from the mode itself, whose step is not small, against the map of one step."""
    rest = rest_of(run)
    exact = piston_roots(rest)[0]
    longest = run.settings()["longest_step"]
    errors = [abs(root_of_steps(rest, exact, longest * by)) / abs(exact.s) - 1.0 for by in (1.0, 2.0)]
    assert errors[1] / errors[0] == pytest.approx(4.0, rel=0.05)
