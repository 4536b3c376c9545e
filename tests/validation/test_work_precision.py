"""Work-precision studies: fronts and choices on known points, and a study of the lone grain."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest

from granular import load_scene, simulate
from granular.records.record import PistonRecord
from granular.shared.errors import InputError
from granular.shared.plotting import figure
from validation import exact_solution
from validation.accuracy_cost import (
    candidate_settings,
    depends_on_seed,
    deviation_over_starts,
    work_precision,
    work_precision_of_quantities,
)
from validation.measured_quantities import MeasuredQuantity, swing_period_and_damping
from validation.recommendation import recommend_from_study, recommend_settings
from validation.work_precision_result import LEVELS, SolverSettings, WorkPrecision, WorkPrecisionPoint


def point(method: str, steps: int, error: float, seconds: float) -> WorkPrecisionPoint:
    return WorkPrecisionPoint(SolverSettings(method, f"auto*{1 / steps}"), error, seconds, steps)


FAILED = WorkPrecisionPoint(SolverSettings("verlet", "auto*8"), math.nan, math.nan, 0, "EnergyError: off")


def study(*points: WorkPrecisionPoint, floor: float = 0.0) -> WorkPrecision:
    return WorkPrecision("scene", "energy", "1", None, points, floor, "the value 0.0")


def test_front_leaves_out_what_is_beaten() -> None:
    fast, slow = point("a", 10, 1e-2, 1.0), point("a", 100, 1e-4, 10.0)
    beaten, best = point("b", 10, 2e-2, 2.0), point("b", 100, 1e-3, 1.5)
    assert study(slow, beaten, FAILED, best, fast).pareto_front() == (fast, best, slow)


def test_a_setting_accurate_by_luck_is_not_chosen() -> None:
    """The coarse step meets the tolerance, the next finer one does not."""
    lucky, missed, sound = (point("a", 10, 1e-5, 1.0), point("a", 20, 1e-2, 2.0), point("a", 40, 1e-4, 4.0))
    found = study(sound, lucky, missed, FAILED)
    assert found.cheapest_point(1e-3) == sound
    assert found.cheapest_point(1e-1) == lucky
    assert found.cheapest_point(1e-9) is None
    with pytest.raises(InputError, match="least error is 1e-05"):
        recommend_from_study(found, 1e-9)


@pytest.mark.parametrize("level", LEVELS)
def test_picture_names_what_cheapest_chooses(level: str) -> None:
    """The words at the line of a level, and the ring, are those of `cheapest`; by hand here."""
    points = (
        point("a", 10, 5e-3, 1.0),
        point("a", 100, 5e-5, 10.0),
        point("a", 1000, 5e-7, 100.0),
        point("b", 10, 2e-2, 2.0),
        point("b", 20, 1e-8, 4.0),
        FAILED,
    )
    outside = WorkPrecisionPoint(SolverSettings("SciPy DOP853", 1e-8), 1e-9, 1e-3, 10)
    found = study(*points, outside)
    wanted = {"1 %": points[0], "0.1 %": points[4], "1e-6": points[4]}[level]
    assert found.cheapest_point(LEVELS[level]) == wanted
    with figure() as (_, axes):
        found.plot(axes)
        words = [one.get_text() for one in axes.texts if one.get_text().startswith(level)]
        rings = [
            (*one.get_xdata(), *one.get_ydata()) for one in axes.get_lines() if one.get_markersize() > 10.0
        ]
    assert words == [f"{level}: {wanted.setting.family}, {wanted.setting.dt}"]
    assert (wanted.seconds, wanted.error) in rings
    assert len(rings) == len(LEVELS)


def test_outside_references_are_shown_and_never_chosen() -> None:
    """The lone grain: SciPy's position is measured like the toolkit's, its energy is not."""
    problem = exact_solution.bounce_problem(time=0.3)
    exact = problem.exact(0.3).positions / 5e-3
    settings = [SolverSettings("stormer-verlet", "auto"), SolverSettings("SciPy DOP853", 1e-10)]
    energy, positions = work_precision_of_quantities(
        problem.scene, ["energy", "positions"], settings, references=[0.0, exact], until=0.3
    )
    assert [one.setting.method for one in energy.points] == ["stormer-verlet"]
    assert [one.setting for one in positions.points] == settings
    assert positions.points[1].error < 1e-6
    assert positions.cheapest_point(1e-1) == positions.points[0]
    assert positions.cheapest_point(1e-6) is None
    assert positions.pareto_front() == positions.points[:1]


def test_choice_is_a_command_and_keywords() -> None:
    setting = SolverSettings("stormer-verlet", "auto*2", {"effects.friction.scheme": "velocity"})
    found = recommend_from_study(study(WorkPrecisionPoint(setting, 1e-3, 1.0, 10)), 1e-2)
    assert found.keywords == {"dt": "auto*2", "method": "stormer-verlet"}
    assert found.changes == {"effects.friction.scheme": "velocity"}
    assert found.command == (
        "python -m granular run scene --set effects.friction.scheme=velocity --dt 'auto*2' "
        "--method stormer-verlet"
    )
    json.dumps(found.to_plain(), allow_nan=False)


def test_study_of_the_lone_grain() -> None:
    """Errors against the exact motion fall with the step, and a choice can be run again."""
    problem = exact_solution.bounce_problem(time=0.3)
    exact = problem.exact(0.3).positions / 5e-3
    settings = [SolverSettings("stormer-verlet", dt) for dt in ("auto*4", "auto", "auto/4")]
    settings.append(SolverSettings("stormer-verlet", 1.0))  # a step longer than the run
    found = work_precision(problem.scene, "positions", settings, reference=exact, until=0.3)
    errors = [one.error for one in found.points[:3]]
    assert errors[0] > 8.0 * errors[1] > 64.0 * errors[2]
    best = recommend_from_study(found, 0.05)
    run = simulate(problem.scene.replace(**best.changes), t_end=0.3, progress=False, **best.keywords)
    again = np.abs(run.dataset["position"].values[-1] / 5e-3 - exact).max()
    assert again == best.error
    assert again <= 0.05


@pytest.mark.parametrize(("tolerance", "tried"), [(0.05, False), (1e-9, True)])
def test_methods_of_many_force_calls_are_tried_where_they_may_pay(tolerance: float, tried: bool) -> None:
    found = recommend_settings(exact_solution.bounce_problem(time=0.3).scene, "energy", tolerance, until=0.3)
    families = {one.setting.family for one in found.study.points}
    assert "stormer-verlet" in families
    assert ("blanes-moan-6" in families) is tried


SEED = MeasuredQuantity("seed", "1", lambda run: float(run.scene.arrangement.seed))


def test_floor_is_the_scatter_over_starts_and_the_error_a_mean() -> None:
    """Every setting is run from the same starts; a bias has a standard error."""
    bed = load_scene("bed").replace(**{"grains.count": 2})
    verlet = SolverSettings("stormer-verlet", 1e-4)
    found = work_precision(bed, SEED, [verlet], reference=verlet, until=0.001, seeds=3)
    assert found.floor == pytest.approx(np.std([1.0, 2.0, 3.0, 4.0], ddof=1) / 2.5)
    assert (found.points[0].error, found.points[0].doubt, found.points[0].starts) == (0.0, 0.0, 4)
    off = work_precision(bed, SEED, [verlet], reference=2.0, until=0.001, seeds=3).points[0]
    assert off.error == pytest.approx(0.25)  # the mean of 1, 2, 3 and 4 is 2.5
    assert off.doubt == pytest.approx(np.std([1.0, 2.0, 3.0, 4.0], ddof=1) / 2.0 / 2.0)


def test_a_scene_without_random_starts_is_run_once() -> None:
    assert not depends_on_seed(load_scene("single-particle"))
    assert depends_on_seed(load_scene("damper"))
    once = work_precision(
        load_scene("single-particle"),
        SEED,
        [SolverSettings("stormer-verlet", 1e-4)],
        reference=1.0,
        until=0.001,
        seeds=3,
    )
    assert once.points[0].starts == 1
    assert once.floor == 0.0


def scattered(starts: int, error: float, doubt: float, steps: int) -> WorkPrecisionPoint:
    return WorkPrecisionPoint(
        SolverSettings("a", f"auto*{1 / steps}"), error, 0.1 * steps, steps, None, doubt, starts
    )


def test_below_three_floors_the_answer_is_more_starts() -> None:
    """Any setting will do, even where one happens to be within the tolerance."""
    points = (scattered(5, 9e-3, 1e-3, 10), scattered(5, 1e-3, 2e-3, 20), scattered(5, 0.0, 2e-3, 40))
    found = study(*points, floor=5e-3)
    advice = found.advise(1e-2)
    assert advice.needs_more_starts
    assert advice.point == points[1]  # the first is clearly biased
    assert advice.starts == 1
    assert found.advise(1e-3).starts == 100
    assert found.advise(1e-3).seconds == pytest.approx(200.0)
    assert "any of these: the starts scatter by 0.005; 100 starts cost 3.3 minutes" in str(found.advise(1e-3))
    assert found.cheapest_point(1e-2) is None
    assert found.cheapest_point(2e-2) == points[0]
    chosen = recommend_from_study(found, 1e-3)
    assert chosen.starts == 100
    assert "any of these" in str(chosen)
    json.dumps(chosen.to_plain(), allow_nan=False)


def test_a_single_lucky_mean_is_no_bound() -> None:
    """An error near nought whose standard error is above the tolerance proves nothing."""
    points = (scattered(5, 1e-4, 2e-2, 10), scattered(5, 1e-3, 1e-3, 20))
    assert study(*points, floor=1e-3).cheapest_point(1e-2) == points[1]


MADE = MeasuredQuantity("made", "1", lambda _: 0.0)


def made_study(
    random: np.random.Generator, starts: int, floor: float
) -> tuple[WorkPrecision, dict[str, tuple[float, float]]]:
    """Two methods' ladders of steps with known biases, and starts that scatter."""
    reference = 1.0 + random.normal(0.0, floor, starts)
    points, truth = [], {}
    for method, order, price in (("second", 2, 1.0), ("fourth", 4, 5.0)):
        coarsest = 10.0 ** random.uniform(-4.0, -1.0)
        for k in range(7):
            bias = coarsest * 2.0 ** (-order * k) * random.choice([-1.0, 1.0])
            values = 1.0 + bias + random.normal(0.0, floor, starts)
            error, doubt = deviation_over_starts(MADE, list(values), list(reference))
            setting, seconds = SolverSettings(method, f"auto/{2**k}"), price * 2.0**k
            points.append(WorkPrecisionPoint(setting, error, seconds, 2**k, None, doubt, starts))
            truth[f"{method} {setting.dt}"] = abs(bias), seconds
    scatter = float(np.std(reference, ddof=1))
    return WorkPrecision("scene", "made", "1", None, tuple(points), scatter, "made"), truth


@pytest.mark.parametrize("starts", [3, 5])
def test_noise_does_not_choose(starts: int) -> None:
    """Of 200 made studies at most 5 % advise a biased setting, or one slower than needed by 2."""
    random, wrong, floor = np.random.default_rng(starts), 0, 1e-3
    for _ in range(200):
        tolerance = floor * 10.0 ** random.uniform(0.5, 2.0)
        found, truth = made_study(random, starts, floor)
        advice = found.advise(tolerance)
        needed = min((s for bias, s in truth.values() if bias <= tolerance), default=math.inf)
        if advice.needs_more_starts:
            continue  # by its own starts, and said so
        if advice.point is None:
            wrong += needed < math.inf
            continue
        bias, seconds = truth[f"{advice.point.setting.method} {advice.point.setting.dt}"]
        wrong += bias > tolerance or seconds > 2.0 * needed
    assert wrong <= 10


def test_a_lucky_point_alone_is_chosen_by_what_was_there_before() -> None:
    """Negative control: without standard errors the same noise chooses wrongly in many trials."""
    random, wrong, floor = np.random.default_rng(1), 0, 1e-3
    for _ in range(200):
        tolerance = floor * 10.0 ** random.uniform(0.5, 2.0)
        found, truth = made_study(random, 2, floor)
        bare = [dataclasses.replace(one, doubt=0.0) for one in found.points]
        best = dataclasses.replace(found, points=tuple(bare), floor=0.0).cheapest_point(tolerance)
        if best is not None:
            wrong += truth[f"{best.setting.method} {best.setting.dt}"][0] > tolerance
    assert wrong > 0


def test_unknown_quantity_is_named() -> None:
    with pytest.raises(InputError, match="did you mean 'energy'"):
        work_precision(load_scene("damper"), "enrgy", [SolverSettings("stormer-verlet", "auto")])
    with pytest.raises(InputError, match="no settings"):
        work_precision(load_scene("damper"), "energy", [])
    with pytest.raises(InputError, match="repeats = 0"):
        work_precision(load_scene("damper"), "energy", [SolverSettings("pefrl", "auto")], repeats=0)


def test_candidates_fit_the_scene() -> None:
    smooth, dry = load_scene("damper"), load_scene("bed").replace(**{"effects.friction": {}})
    assert {one.method for one in candidate_settings(smooth)} > {"stormer-verlet", "blanes-moan-4"}
    assert {one.method for one in candidate_settings(dry)} == {"stormer-verlet"}


@pytest.mark.parametrize("scheme", ["velocity", "regularised"])
def test_candidates_never_change_the_law(scheme: str) -> None:
    """The former advice for a bed with friction was another friction law, by a lucky point."""
    scene = load_scene("bed").replace(**{"effects.drag": None, "effects.friction.scheme": scheme})
    assert all(not one.changes for one in candidate_settings(scene))


@pytest.mark.parametrize(("period", "ratio"), [(0.288, 0.037), (1.0, 0.2), (0.01, 0.001)])
def test_small_swing_of_a_damped_oscillation(period: float, ratio: float) -> None:
    omega = 2.0 * math.pi / period / math.sqrt(1.0 - ratio**2)  # so that the period is damped
    time = np.arange(0.0, 12.0 * period, period / 200.0)
    damped = omega * math.sqrt(1.0 - ratio**2)
    height = 0.06 + 1e-3 * np.exp(-ratio * omega * time) * np.cos(damped * time + 0.3)
    found = swing_period_and_damping(PistonRecord(time=time, height=height))
    assert found == pytest.approx((period, ratio), rel=1e-3)
