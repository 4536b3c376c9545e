"""Laws judged on falls that were made by a known law."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import score_drops
from reduced_models.falls.unseen_fall_scores import DropScore, DropScores
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.solution import solve_law

SPRING = LAWS["power-law-spring"]
TRUE = [{"lam": 0.8, "weight": 9.8, "rest": 0.06, "power": 2.5}[name] for name in SPRING.parameters]
TIME = np.linspace(0.0, 2.0, 800)


def fall(height: float, seed: int = 0, noise: float = 0.0) -> PistonRecord:
    clean = solve_law(SPRING, TIME, height, 0.0, TRUE, 0.03).z
    other = np.random.default_rng(seed).normal(0.0, noise, len(clean))
    other[0] = 0.0
    return PistonRecord(TIME, clean + other)


@pytest.fixture(scope="module")
def falls() -> DropScores:
    unseen = {"low": fall(0.08), "high": fall(0.14), "again": fall(0.11, 1, 1e-4)}
    return score_drops(fall(0.11), unseen, ["linear", "power-law-spring"], rest=0.06)


def test_the_law_that_made_them_is_first(falls: DropScores) -> None:
    assert [row.name for row in falls.rows] == ["power-law-spring", "linear"]
    best = falls.best
    assert best.model is not None
    assert best.model.parameters["power"] == pytest.approx(2.5, rel=1e-4)
    assert max(best.errors[:2]) < 1e-4
    assert falls.rows[1].median_error > 0.02


def test_scatter_is_of_falls_from_the_same_height(falls: DropScores) -> None:
    (scatter,) = falls.scatter
    assert scatter == pytest.approx(1e-4 / 0.05, rel=0.1)
    assert falls.best.errors[2] == pytest.approx(scatter, rel=0.1)


def test_table_and_verdict_say_it(falls: DropScores) -> None:
    lines = str(falls.table).splitlines()
    assert lines[0].split() == ["law", "numbers", "fitted", "low", "high", "again", "median"]
    assert lines[1].startswith("power-law-spring  4")
    assert "predicted best by power-law-spring" in falls.verdict
    assert "another random start alone changes 0.2 %" in falls.verdict
    assert json.loads(json.dumps(falls.to_plain()))["labels"] == ["low", "high", "again"]
    axes = falls.plot()
    assert len(axes.get_lines()) == 2


def test_a_law_that_blows_up_or_fails_is_said(falls: DropScores) -> None:
    lost = dataclasses.replace(falls.rows[1], errors=(0.1, math.inf, math.inf))
    none = DropScore("coulomb", None, failure="too short")
    found = dataclasses.replace(falls, rows=(falls.best, lost, none))
    assert "linear diverges" in found.verdict
    assert found.cells()[1][-2:] == ("diverges", "diverges")
    assert found.cells()[2][-1] == "not fitted"
    assert len(found.plot().get_lines()) == 2
    nothing = dataclasses.replace(falls, rows=(lost,))
    assert nothing.verdict == "No law that was fitted to one fall follows the others."


def test_bad_input_is_said() -> None:
    with pytest.raises(InputError, match="at least one unseen fall"):
        score_drops(fall(0.11), {})
    with pytest.raises(InputError, match=r"low begins at 0\.05 m, not above the level of rest"):
        score_drops(fall(0.11), {"low": fall(0.05)}, rest=0.06)
    with pytest.raises(InputError, match="rest = -inf; give a finite number"):
        score_drops(fall(0.11), {"high": fall(0.14)}, rest=-np.inf)
    with pytest.raises(InputError, match="no law could be fitted"):
        score_drops(fall(0.11).first(4), {"high": fall(0.14)}, ["linear"], rest=0.06)
