"""The line on what an identified run cost and risks."""

from __future__ import annotations

from granular import load_scene, simulate
from granular.run.price_table import price_text
from reduced_models.identification.engineering import Figure
from reduced_models.identification.result import checked_price_text


def test_the_step_check_is_told_where_there_was_one() -> None:
    run = simulate(load_scene("single-particle"), 1e-4, 0.05, progress=False)
    told = checked_price_text(run, Figure(0.06, (0.06, 0.06), 1.2e-6))
    assert "rest height to 2e-05 by the step check; twice as fine: " in told
    scattered = checked_price_text(run, Figure(0.06, (0.06, 0.06), 1.2e-6, 6e-5))
    assert "starts scatter it by 0.001" in scattered
    assert "no better where the starts decide" in scattered
    assert checked_price_text(run, Figure(0.06, (0.06, 0.06))) == price_text(run)
