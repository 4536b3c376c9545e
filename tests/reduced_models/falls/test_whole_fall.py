"""A whole fall and its energy balance by the law; laws compared on falls that were not fitted."""

import dataclasses
import json
import math

import numpy as np
import pytest

from granular import PistonRecord, damper
from granular.shared.errors import InputError
from reduced_models import predict, score_drops
from reduced_models.__main__ import main
from reduced_models.falls.predicted_law import OutsideRangeWarning
from reduced_models.falls.unseen_fall_scores import DropScore, DropScores, whole_fall
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.solution import solve_law

HEIGHT = 0.12


def test_printed_results_of_a_fall_agree_with_its_predicted_motion() -> None:
    """The reference uses another solver."""
    scene = damper()
    found = whole_fall(scene, HEIGHT)
    motion = predict(scene).simulate(np.linspace(0.0, 3.0, 3001), z0=HEIGHT, v0=0.0)
    assert found.deepest == pytest.approx(motion.height.min(), rel=1e-5)
    outside = np.abs(motion.height - found.rest) > 0.05 * (HEIGHT - found.rest)
    assert found.settling_time == pytest.approx(motion.time[outside][-1], abs=2e-3)
    assert found.greatest_force > 7.5 * 9.8


def test_a_warning_is_given_if_a_fall_presses_discs_into_contact() -> None:
    """With 10 kg from 20 D the simulated fall differs from the law by 5 % of the drop, with 7.5 kg by
    1.2 %.
    """
    with pytest.warns(OutsideRangeWarning, match="where discs of 'magnets' touch"):
        hard = whole_fall(damper(10.0, magnets="cylinders"), simulate=False)
    soft = whole_fall(damper(magnets="cylinders"), simulate=False)
    assert hard.deepest < soft.deepest


def test_losses_of_a_predicted_fall_equal_the_released_energy() -> None:
    """The released energy is the piston's potential energy minus the work against the pressure.

    Both losses are positive.
    """
    scene = damper(drag=0.4)  # settles within the computed time
    found = whole_fall(scene, HEIGHT)
    values = predict(scene).parameters
    rest, power = values["rest"], values["power"]
    moved = 1.046 * 7.5 * 9.8 / values["weight"]
    against = (rest - rest**power * HEIGHT ** (1.0 - power)) / (power - 1.0)
    given = moved * values["weight"] * (HEIGHT - rest - against)
    assert found.affine_loss > 0.0
    assert found.excess_loss > 0.0
    assert found.affine_loss + found.excess_loss == pytest.approx(given, rel=0.02)


def test_a_predicted_fall_from_below_the_equilibrium_height_is_refused() -> None:
    with pytest.raises(InputError, match="not above the height of rest"):
        whole_fall(damper(), 0.05)
    with pytest.raises(InputError, match="height = 'high'; give a number"):
        whole_fall(damper(), "high")  # type: ignore[arg-type]  # the error is tested


def test_command_fall_prints_the_results_of_the_fall(capsys: pytest.CaptureFixture[str]) -> None:
    main(["fall", "damper", "--height", "120 mm", "--json"])
    said = json.loads(capsys.readouterr().out)
    assert said == pytest.approx(whole_fall(damper(), HEIGHT)._asdict())


def test_a_fall_outside_the_tested_range_of_the_law_is_also_simulated(
    capsys: pytest.CaptureFixture[str],
) -> None:
    small = damper(count=92)
    with pytest.warns(OutsideRangeWarning, match="92 grains"):
        found = whole_fall(small, progress=False)
    assert found.simulated.rest == pytest.approx(found.rest, rel=0.1)
    assert found.simulated.affine_loss == pytest.approx(found.affine_loss, rel=0.3)
    assert found.simulated.excess_loss > 0.0
    assert "by the law: falls" in str(found)
    assert "simulated: falls" in str(found)
    with pytest.warns(OutsideRangeWarning):
        main(["fall", "damper", "--set", "grains.count=92", "--law-only", "--json"])
    assert json.loads(capsys.readouterr().out)["simulated"] is None


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


def test_comparison_of_laws_on_falls_ranks_the_law_that_generated_them_first(falls: DropScores) -> None:
    assert [row.name for row in falls.rows] == ["power-law-spring", "linear"]
    best = falls.best
    assert best.model.parameters["power"] == pytest.approx(2.5, rel=1e-4)
    assert max(best.errors[:2]) < 1e-4
    assert falls.rows[1].median_error > 0.02


def test_spread_over_packings_is_computed_from_falls_from_the_same_height(falls: DropScores) -> None:
    (scatter,) = falls.scatter
    assert scatter == pytest.approx(1e-4 / 0.05, rel=0.1)
    assert falls.best.errors[2] == pytest.approx(scatter, rel=0.1)


def test_comparison_of_laws_on_falls_prints_the_best_law_and_the_spread_over_packings(
    falls: DropScores,
) -> None:
    lines = str(falls.table).splitlines()
    assert lines[0].split() == ["law", "numbers", "fitted", "low", "high", "again", "median"]
    assert lines[1].startswith("power-law-spring  4")
    assert "predicted best by power-law-spring" in falls.verdict
    assert "a different random packing alone changes a fall by 0.2 %" in falls.verdict
    assert json.loads(json.dumps(falls.to_plain()))["labels"] == ["low", "high", "again"]
    axes = falls.plot()
    assert len(axes.get_lines()) == 2


def test_comparison_of_laws_on_falls_reports_laws_that_diverge_or_fail(falls: DropScores) -> None:
    lost = dataclasses.replace(falls.rows[1], errors=(0.1, math.inf, math.inf))
    none = DropScore("coulomb", None, failure="too short")
    found = dataclasses.replace(falls, rows=(falls.best, lost, none))
    assert "linear diverges" in found.verdict
    assert [row[-1] for row in found.cells()[1:]] == ["diverges", "not fitted"]
    nothing = dataclasses.replace(falls, rows=(lost,))
    assert nothing.verdict == "No law fitted to one fall can predict the others."


def test_comparison_of_laws_on_invalid_falls_is_refused() -> None:
    start, high = fall(0.11), {"high": fall(0.14)}
    for given, words in (
        (((start, {}), {}), "one or more held-out falls"),
        (
            ((start, {"low": fall(0.05)}), {"rest": 0.06}),
            r"low starts at 0\.05 m, not above the height of rest",
        ),
        (((start, high), {"rest": -np.inf}), "rest = -inf; give a finite number"),
        (((start.first(4), high, ["linear"]), {"rest": 0.06}), "no law could be fitted"),
    ):
        with pytest.raises(InputError, match=words):
            score_drops(*given[0], **given[1])
