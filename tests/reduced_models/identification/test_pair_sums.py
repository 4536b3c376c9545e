"""The sum over pairs that the runs of an identification and of a design are made with."""

from __future__ import annotations

import importlib
from concurrent.futures import Executor, Future
from typing import Any

import pytest

from granular import Plan, Scene, damper, plan
from granular.studies.cases import Case
from reduced_models import IdentifyOptions, design, identify

IDENTIFY = importlib.import_module("reduced_models.identification.identify")


class Asked(Executor):
    """Keeps what was asked, and computes nothing."""

    def __init__(self) -> None:
        self.scenes: list[Scene] = []

    def submit(self, _: Any, case: Case, *__: Any, **___: Any) -> Future[Any]:
        self.scenes.append(case.scene)
        return Future()


class StoppedError(RuntimeError):
    """Ends what would simulate."""


def summed(
    monkeypatch: pytest.MonkeyPatch, scene: Scene | Plan, checks: bool = True
) -> tuple[str, str, set[str]]:
    """Method of summing pairs and step of the scene's own run, and the methods of its checks."""
    ran, asked = [], Asked()

    def run(chosen: Plan, *_: Any) -> None:
        ran.append((chosen.pair_sum, str(chosen.dt)))
        raise StoppedError

    monkeypatch.setattr(IDENTIFY, "run_plan", run)
    with pytest.raises(StoppedError):
        identify(scene, options=IdentifyOptions(checks=checks, executor=asked), progress=False)
    return *ran[0], {one.pair_method for one in asked.scenes}


def test_a_scene_and_its_checks_are_summed_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    assert summed(monkeypatch, damper()) == ("mesh", "auto*4", {"mesh"})
    assert summed(monkeypatch, damper(count=300)) == ("direct", "auto*4.43", {"direct"})
    assert summed(monkeypatch, damper(count=92)) == ("direct", "auto*2", {"direct"})


def test_what_is_asked_for_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    assert summed(monkeypatch, plan(damper())) == ("direct", "auto", {"direct"})
    named = damper().replace(**{"pairs.method": "direct"})
    assert summed(monkeypatch, named) == ("direct", "auto*4", {"direct"})


def test_a_single_run_does_not_pay_for_the_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    assert summed(monkeypatch, damper(), checks=False) == ("direct", "auto*4", set())


@pytest.mark.parametrize(("grains", "pairs", "dt"), [(368, "direct", "auto*4"), (184, "direct", "auto*1.41")])
def test_a_proposal_is_simulated_by_the_fastest_sum_and_step_that_starts_hide(
    monkeypatch: pytest.MonkeyPatch, grains: int, pairs: str, dt: str
) -> None:
    asked: list[tuple[str, str]] = []

    def sweep(_: Scene, cases: list[dict[str, Any]], dt: str, **__: Any) -> None:
        asked.extend((Scene.from_plain(case).pair_method, dt) for case in cases)
        raise StoppedError

    monkeypatch.setattr(importlib.import_module("reduced_models.designs.design"), "sweep", sweep)
    with pytest.raises(StoppedError):
        design(3.6, 0.15, grains=grains, small_share=0.3, executor=Asked(), progress=False)
    assert asked == [(pairs, dt)]
