"""Cases that are computed while the caller works."""

import os
from collections.abc import Mapping

from granular import load_scene
from granular.run.trajectory import Trajectory
from granular.studies.sweep import BackgroundCaseRunner


def step_and_process(run: Trajectory) -> Mapping[str, float]:
    return {"dt": run.settings()["dt"], "process": os.getpid()}


def test_who_waits_computes_what_no_process_has_begun() -> None:
    steps = [1e-3 / parts for parts in range(1, 13)]
    settings = {"dt": 1e-3, "t_end": 1e-2, "method": "stormer-verlet"}
    with BackgroundCaseRunner(step_and_process, None) as background:
        cases = [{"dt": step} for step in steps]
        started = background.submit_cases(load_scene("single-particle"), cases, settings)
        outcomes = background.wait_for_outcomes(started, "cases", False)
    assert [outcome.error for outcome in outcomes] == [None] * len(steps)
    assert [outcome.figures["dt"] for outcome in outcomes] == steps
    assert outcomes[-1].figures["process"] == os.getpid() != outcomes[0].figures["process"]
