"""The judgement of outcomes, on runs that are made to end in every way."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable

import pytest

from granular import Scene, Trajectory, load_scene
from granular.shared.errors import EnergyError, SceneError
from validation.hard_case import ErrorMeasure, HardCase
from validation.hard_case_outcomes import (
    ACCURATE,
    CRASHED,
    DEGRADED,
    SILENT,
    STOPPED,
    HardCaseOutcome,
    run_hard_case,
)


def scene() -> Scene:
    return load_scene("single-particle")


def refused() -> Scene:
    raise SceneError("a value, a limit, a remedy")


def broken() -> Scene:
    raise ZeroDivisionError


def energy_lost(_: Trajectory) -> float:
    raise EnergyError("off", step=1, time=0.0, remedy="shorten dt")


def warned(_: Trajectory) -> float:
    warnings.warn("the energy ledger is off", stacklevel=1)
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
def test_every_ending_is_told(one: HardCase, kind: str, allowed: bool) -> None:
    found = run_hard_case(one)
    assert found.kind == kind
    assert found.allowed is allowed
    again = HardCaseOutcome.from_plain(json.loads(json.dumps(found.to_plain())))
    assert again.to_plain() == found.to_plain()
