"""Advice and promises of accuracy, followed with five fresh starts."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence

import pytest

from granular import Scene, Trajectory, damper, load_scene, plan, simulate
from granular.run.plan import parse_accuracy
from validation import SolverSettings, recommend_settings
from validation.accuracy_cost import compare_with_references, compression_scene, scenes_with_other_seeds
from validation.measured_quantities import QUANTITIES

FRESH = 5
FIRST = 1001
"""Seed of the first fresh start: no study has seen it."""
REFERENCE = SolverSettings("stormer-verlet", "auto/4")
KNOWN_STARTS = 12


def rubbing() -> Scene:
    """A damper of few grains under dry friction, and of the piston: grains that stick damp none."""
    changes = {"name": "rubbing", "effects.friction": {}, "piston.friction": "0.5 N"}
    return damper(count=92).replace(**changes)


def runs_of(scene: Scene, starts: int, **keywords: object) -> Iterator[Trajectory]:
    """Whole runs of fresh starts."""
    for seed in range(FIRST, FIRST + starts):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            other = scene.replace(**{"arrangement.seed": seed})
            yield simulate(other, progress=False, **keywords)  # type: ignore[arg-type]  # by name


def errors(scene: Scene, quantity: str, runs: Sequence[Trajectory]) -> list[float]:
    """Of each run, against the mean of other starts at a shorter step, or the exact value."""
    one = QUANTITIES[quantity]
    if one.exact is not None:
        return [one.error(one.measure(run), one.exact) for run in runs]
    others = scenes_with_other_seeds(scene, KNOWN_STARTS - 1)
    (truth,) = compare_with_references(others, [one], [REFERENCE], None).truth
    mean = sum(truth.values) / len(truth.values)
    return [one.error(one.measure(run), mean) for run in runs]


@pytest.mark.long
@pytest.mark.parametrize(
    ("scene", "quantity", "tolerance"),
    [
        (compression_scene(), "piston force", 0.03),
        (compression_scene(), "mean distance", 0.005),
        (compression_scene(), "energy", 1e-4),
        (rubbing(), "rest height", 0.02),
        (damper(count=92), "rest height", 0.002),
        (damper(count=92), "period", 0.01),
    ],
    ids=lambda one: one.name if isinstance(one, Scene) else str(one),
)
def test_the_cheapest_setting_keeps_its_tolerance(scene: Scene, quantity: str, tolerance: float) -> None:
    choice = recommend_settings(scene, quantity, tolerance)
    print(choice)
    if choice.needs_more_starts:
        assert choice.starts > 1
        return
    runs = list(runs_of(scene.replace(**choice.changes), FRESH, **choice.keywords))
    found = errors(scene, quantity, runs)
    print(found)
    assert max(found) <= tolerance


@pytest.mark.long
@pytest.mark.parametrize(
    ("scene", "text"),
    [
        (compression_scene(), "2 % piston force"),
        (compression_scene(), "0.5 % mean distance"),
        (compression_scene(), "1e-4 energy"),
        (damper(count=92), "2e-3 rest height"),
        (damper(count=92), "1 % period"),
        (damper(count=92), "1e-3 energy"),
        (load_scene("damper"), "1e-3 rest height"),
        (load_scene("damper"), "0.5 % period"),
        (load_scene("damper"), "1e-3 energy"),
    ],
    ids=lambda one: one.name if isinstance(one, Scene) else str(one),
)
def test_an_accuracy_that_is_promised_is_kept(scene: Scene, text: str) -> None:
    print(plan(scene, accuracy=text).words)
    tolerance, quantity = parse_accuracy(text)
    found = errors(scene, quantity, list(runs_of(scene, FRESH, accuracy=text)))
    print(found)
    assert max(found) <= tolerance
