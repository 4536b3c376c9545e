"""Quick runs of the catalogue of difficult scenes, and the classification of how they end."""

import math
import warnings
from collections.abc import Callable

import pytest

from granular import Scene, Trajectory, load_scene, simulate
from granular.shared.errors import EnergyError, SceneError
from validation.hard_case import (
    ErrorMeasure,
    HardCase,
    make_distance_from_verlet_oscillation,
    scene_near_stability_limit,
)
from validation.hard_case_outcomes import ACCURATE, CRASHED, DEGRADED, SILENT, STOPPED, run_hard_case
from validation.hard_cases import hard_case_catalogue
from validation.overview import COSTLY

CASES = hard_case_catalogue()
ALONE = ("drag with gamma", "remanence of 1e-4", "gravity of 1e4")
"""Cases that compile code of their kind only, or that take a second or more; other extremes are quick."""


def marked(case: HardCase) -> object:
    marks = []
    if any(word in case.name for word in (*COSTLY, *ALONE)):
        marks.append(pytest.mark.long)
    return pytest.param(case, id=case.name, marks=marks)


@pytest.mark.parametrize("case", [marked(case) for case in CASES])
def test_each_difficult_scene_ends_in_an_allowed_way(case: HardCase) -> None:
    found = run_hard_case(case)
    assert found.kind not in (SILENT, CRASHED), f"{found.error} {found.said}"
    assert found.allowed, f"{found.kind}: {found.error} {found.said}"


def test_verlet_oscillation_depends_on_the_exact_step() -> None:
    """The run is far from Verlet's oscillation computed for a slightly shorter step."""
    scene, step = scene_near_stability_limit(0.95)
    run = simulate(scene(), step, 384 * step, progress=False)
    assert make_distance_from_verlet_oscillation(0.95, step)(run) < 1e-4
    assert make_distance_from_verlet_oscillation(0.949, step)(run) > 0.1


def test_a_large_oscillation_near_the_stability_limit_is_stopped() -> None:
    """At 0.95 of the limit Verlet's oscillation is bounded, but its energy is not conserved."""
    scene, step = scene_near_stability_limit(0.95, 1e-3)
    with pytest.raises(EnergyError):
        simulate(scene(), step, 20.0, progress=False)


def test_names_of_difficult_scenes_are_unique() -> None:
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names)


def test_only_listed_difficult_scenes_may_end_in_an_error() -> None:
    """The list is in the docstring of the catalogue."""
    words = (
        "coincident",
        "overlapping start",
        "injected",
        "inside the bed",
        "1.05 of the stability limit",
        "step 100 times",
        "out of range",
        "list",
    )
    for case in CASES:
        if case.errors:
            assert any(word in case.name for word in words), case.name
    assert not next(one for one in CASES if one.name == "overlapping start with contact").errors


def scene() -> Scene:
    return load_scene("single-particle")


def refused() -> Scene:
    raise SceneError("a value, a limit, a remedy")


def broken() -> Scene:
    raise ZeroDivisionError


def energy_lost(_: Trajectory) -> float:
    raise EnergyError("off", step=1, time=0.0, remedy="shorten dt")


def warned(_: Trajectory) -> float:
    warnings.warn("the energy balance is off", stacklevel=1)
    return 1.0


def overlapping(_: Trajectory) -> float:
    warnings.warn("two grains came as close as 1 m, less than a diameter", stacklevel=1)
    return 1.0


def case(
    measure: Callable[[Trajectory], float] = lambda _: 0.0,
    made: Callable[[], Scene] = scene,
    **options: object,
) -> HardCase:
    return HardCase(
        "case", "what", made, (0.001, 0.001), ErrorMeasure("error", measure), 0.1, dt=1e-4, **options
    )


@pytest.mark.parametrize(
    ("one", "kind", "allowed"),
    [
        (case(), ACCURATE, True),
        (case(lambda _: 0.2), SILENT, False),
        (case(lambda _: math.nan), SILENT, False),
        (case(warned), DEGRADED, False),
        (case(warned, may_degrade=True), DEGRADED, True),
        (case(overlapping, may_degrade=True), SILENT, False),
        (case(energy_lost), STOPPED, False),
        (case(energy_lost, errors=("EnergyError",)), STOPPED, True),
        (case(energy_lost, errors=("SceneError",)), STOPPED, False),
        (case(made=refused, errors=("SceneError",)), STOPPED, True),
        (case(made=broken, errors=("ZeroDivisionError",)), CRASHED, False),
    ],
)
def test_every_way_in_which_a_run_can_end_is_classified(one: HardCase, kind: str, allowed: bool) -> None:
    found = run_hard_case(one)
    assert found.kind == kind
    assert found.allowed is allowed
