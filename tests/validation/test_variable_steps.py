"""Variable steps: few force calls for a hard collision, and no trend over many bounces."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from granular import Trajectory, simulate
from validation import exact_solution
from validation.energy_drift import EnergyRun, run_energy_study, variable_step_bounce_run
from validation.hard_case import energy_change, head_on_collision

LIMIT = 1e-6


def collide(dt: float | str, method: str) -> Trajectory:
    problem = head_on_collision(0.02)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # they come nearer than a diameter, and are meant to
        return simulate(problem.scene, dt, problem.time, method, progress=False)


def test_head_on_pair_needs_a_fifth_of_the_force_calls() -> None:
    """Both methods evaluate the forces once a step; the pair comes as near as 0.02 D.

    The fewest equal steps that keep the energy to 1e-6 are looked for in jumps of 3 %, from a
    number on that leaves an error of a part in a thousand or more.
    """
    time, count = head_on_collision(0.02).time, 1400
    assert energy_change(collide(time / count, "stormer-verlet")) > 1e3 * LIMIT
    while energy_change(collide(time / count, "stormer-verlet")) > LIMIT:
        count = round(1.03 * count)
    variable = collide("auto*8", "adaptive-verlet")
    assert energy_change(variable) < LIMIT
    assert int(variable.settings()["steps"]) <= count / 5


def test_head_on_pair_gets_better_with_the_step() -> None:
    errors = [energy_change(collide(dt, "adaptive-verlet")) for dt in ("auto*8", "auto*6")]
    assert errors[1] < 0.2 * errors[0] < 0.2 * LIMIT


def test_ten_thousand_bounces_have_no_trend() -> None:
    """Some 160 steps a bounce; the step changes by a factor of fifteen within each."""
    found = run_energy_study(variable_step_bounce_run())
    assert found.stopped is None
    assert found.steps > 1e6
    assert found.trend.verdict() == "none"
    assert abs(found.trend.total_drift) < 0.1 * found.trend.swing
    assert np.abs(found.errors).max() < 0.01


@pytest.mark.long
def test_a_control_loses_energy_over_far_fewer_bounces() -> None:
    """Negative control: the same test finds the trend of a method that has one.

    Quick: trends that are put into made series, in `test_trend`.
    """
    scene = exact_solution.bounce_problem().scene
    time = 100.0 * float(exact_solution.bounce_period(scene))
    records = {"output.scalars": time / 2048, "output.frames": time}
    found = run_energy_study(EnergyRun("bounces", scene.replace(**records), "runge-kutta-4", 1e-3, time))
    assert found.trend.verdict() == "loses"
