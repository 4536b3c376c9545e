"""What the law says of a whole fall, next to a simulation, and next to its own energy."""

from __future__ import annotations

import json

import numpy as np
import pytest

from granular import damper, simulate
from granular.shared.errors import InputError
from reduced_models import predict
from reduced_models.__main__ import main
from reduced_models.falls.predicted_law import OutsideRangeWarning
from reduced_models.falls.unseen_fall_scores import whole_fall

HEIGHT = 0.12


def test_figures_are_those_of_the_predicted_motion() -> None:
    """Solved by another solver."""
    scene = damper()
    found = whole_fall(scene, HEIGHT)
    motion = predict(scene).simulate(np.linspace(0.0, 3.0, 3001), z0=HEIGHT, v0=0.0)
    assert found.deepest == pytest.approx(motion.height.min(), rel=1e-5)
    outside = np.abs(motion.height - found.rest) > 0.05 * (HEIGHT - found.rest)
    assert found.settling_time == pytest.approx(motion.time[outside][-1], abs=2e-3)
    assert found.greatest_force > 7.5 * 9.8


def test_a_fall_that_presses_discs_together_is_told_with_a_warning() -> None:
    """With 10 kg from 20 D a simulated fall differs by 5 % of the drop, with 7.5 kg by 1.2 %."""
    with pytest.warns(OutsideRangeWarning, match="where discs of 'magnets' touch"):
        hard = whole_fall(damper(10.0, magnets="cylinders"), simulate=False)
    soft = whole_fall(damper(magnets="cylinders"), simulate=False)
    assert hard.deepest < soft.deepest


def test_losses_are_what_the_fall_gives_up() -> None:
    """The piston's drop less the work against the pressure, at rest; both losses are positive."""
    scene = damper(drag=0.4)  # at rest in the time that is followed
    found = whole_fall(scene, HEIGHT)
    values = predict(scene).parameters
    rest, power = values["rest"], values["power"]
    moved = 1.046 * 7.5 * 9.8 / values["weight"]
    against = (rest - rest**power * HEIGHT ** (1.0 - power)) / (power - 1.0)
    given = moved * values["weight"] * (HEIGHT - rest - against)
    assert found.affine_loss > 0.0
    assert found.excess_loss > 0.0
    assert found.affine_loss + found.excess_loss == pytest.approx(given, rel=0.02)


@pytest.mark.long  # quick: the two above
def test_a_simulation_says_the_same() -> None:
    scene = damper()
    changes = {"output.record": None, "protocol": [{"kind": "free", "name": "drop", "duration": 3.0}]}
    run = simulate(scene.replace(**changes), dt="auto*2", progress=False)
    motion, found = run.piston(), whole_fall(scene)
    assert motion.velocity is not None
    assert motion.force is not None
    lost = float(np.trapezoid(368 * 0.1 / 3.0 * motion.velocity**2, motion.time))
    assert found.rest == pytest.approx(float(motion.height[-300:].mean()), rel=0.02)
    assert found.deepest == pytest.approx(float(motion.height.min()), rel=0.05)
    assert found.greatest_force == pytest.approx(float(motion.force.max()), rel=0.08)
    assert found.affine_loss == pytest.approx(lost, rel=0.1)
    integer = float(run.dataset["drag_loss"].values[-1])
    assert found.affine_loss + found.excess_loss == pytest.approx(integer, rel=0.1)


def test_a_start_below_rest_is_refused() -> None:
    with pytest.raises(InputError, match="not above the level of rest"):
        whole_fall(damper(), 0.05)
    with pytest.raises(InputError, match="height = 'high'; give a number"):
        whole_fall(damper(), "high")  # type: ignore[arg-type]  # what is refused


def test_the_command_says_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    main(["fall", "damper", "--height", "120 mm", "--json"])
    said = json.loads(capsys.readouterr().out)
    assert said == pytest.approx(whole_fall(damper(), HEIGHT)._asdict())


def test_a_fall_that_was_compared_with_nothing_is_simulated(capsys: pytest.CaptureFixture[str]) -> None:
    small = damper(count=92)
    with pytest.warns(OutsideRangeWarning, match="92 grains"):
        found = whole_fall(small, progress=False)
    assert found.simulated is not None
    assert found.simulated.rest == pytest.approx(found.rest, rel=0.1)
    assert found.simulated.affine_loss == pytest.approx(found.affine_loss, rel=0.3)
    assert found.simulated.excess_loss > 0.0
    assert "by the law: falls" in str(found)
    assert "simulated: falls" in str(found)
    with pytest.warns(OutsideRangeWarning):
        main(["fall", "damper", "--set", "grains.count=92", "--law-only", "--json"])
    assert json.loads(capsys.readouterr().out)["simulated"] is None
