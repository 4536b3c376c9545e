"""The line on what an identified run cost and risks."""

from __future__ import annotations

from granular import load_scene, simulate
from granular.run.work_precision import work_precision_text
from reduced_models.identification.pictures import checked_work_precision_text
from reduced_models.models.quantities import QuantityWithError


def test_the_step_check_is_told_where_there_was_one() -> None:
    run = simulate(load_scene("single-particle"), 1e-4, 0.05, progress=False)
    rest = QuantityWithError("natural frequency", "f0", "Hz", 60.0, {"fit": 0.0})
    told = checked_work_precision_text(run, rest._replace(parts={"step": 1.2e-3}))
    assert "natural frequency to 2e-05 by the step check; twice as fine: " in told
    scattered = checked_work_precision_text(run, rest._replace(parts={"step": 1.2e-3, "start": 6e-2}))
    assert "starts scatter it by 0.001" in scattered
    assert "no better where the starts decide" in scattered
    assert checked_work_precision_text(run, rest) == work_precision_text(run)
