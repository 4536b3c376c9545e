"""Cost and accuracy of methods and steps: choices for known results, and advised settings tested on new
starts.
"""

import dataclasses
import json
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest

from granular import Scene, Trajectory, damper, load_scene, simulate
from granular.records.record import PistonRecord
from granular.run.plan import parse_tolerance_and_quantity
from granular.shared.errors import InputError
from granular.shared.plotting import figure
from validation import exact_solution
from validation.accuracy_cost import (
    error_and_standard_error_over_starts,
    quarter_bed_compression_scene,
    scene_depends_on_seed,
    scenes_with_other_seeds,
    scenes_with_reference_values,
    settings_to_try,
    work_precision,
    work_precision_of_quantities,
)
from validation.measured_quantities import QUANTITIES, MeasuredQuantity, oscillation_period_and_damping
from validation.recommendation import recommend_from_study, recommend_settings
from validation.work_precision_result import LEVELS, SolverSettings, WorkPrecision, WorkPrecisionPoint

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")


def point(method: str, steps: int, error: float, seconds: float) -> WorkPrecisionPoint:
    return WorkPrecisionPoint(SolverSettings(method, f"auto*{1 / steps}"), error, seconds, steps)


FAILED = WorkPrecisionPoint(SolverSettings("verlet", "auto*8"), math.nan, math.nan, 0, "EnergyError: off")


def study(*points: WorkPrecisionPoint, floor: float = 0.0) -> WorkPrecision:
    return WorkPrecision("scene", "energy", "1", None, points, floor, "the value 0.0")


def test_settings_that_are_both_slower_and_less_accurate_are_excluded() -> None:
    fast, slow = point("a", 10, 1e-2, 1.0), point("a", 100, 1e-4, 10.0)
    beaten, best = point("b", 10, 2e-2, 2.0), point("b", 100, 1e-3, 1.5)
    assert study(slow, beaten, FAILED, best, fast).pareto_front() == (fast, best, slow)


def test_a_setting_accurate_by_chance_is_not_chosen() -> None:
    """The coarse step meets the tolerance, the next finer one does not."""
    lucky, missed, sound = (point("a", 10, 1e-5, 1.0), point("a", 20, 1e-2, 2.0), point("a", 40, 1e-4, 4.0))
    found = study(sound, lucky, missed, FAILED)
    assert found.cheapest_point(1e-3) == sound
    assert found.cheapest_point(1e-1) == lucky
    assert found.cheapest_point(1e-9) is None
    with pytest.raises(InputError, match="smallest error is 1e-05"):
        recommend_from_study(found, 1e-9)


def test_plot_marks_the_cheapest_setting_for_a_tolerance() -> None:
    """The cheapest setting is computed by hand."""
    best = [point("a", 10, 5e-3, 1.0), point("b", 20, 1e-8, 4.0)]
    others = [point("a", 100, 5e-5, 10.0), point("a", 1000, 5e-7, 100.0), point("b", 10, 2e-2, 2.0), FAILED]
    outside = WorkPrecisionPoint(SolverSettings("SciPy DOP853", 1e-8), 1e-9, 1e-3, 10)
    found = study(*best, *others, outside)
    wanted = dict(zip(LEVELS, (best[0], best[1], best[1]), strict=True))
    assert {level: found.cheapest_point(limit) for level, limit in LEVELS.items()} == wanted
    with figure() as (_, axes):
        found.plot(axes)
        words = [one.get_text() for one in axes.texts]
        rings = [one for one in axes.get_lines() if one.get_markersize() > 10.0]
        places = [(*one.get_xdata(), *one.get_ydata()) for one in rings]
    for level, one in wanted.items():
        assert f"{level}: {one.setting.family}, {one.setting.dt}" in words
        assert (one.seconds, one.error) in places
    assert len(places) == len(LEVELS)


def test_external_integrators_are_shown_but_never_chosen() -> None:
    """For a single grain, SciPy's position is measured like the toolkit's, but not its energy."""
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


def test_a_recommendation_gives_a_command_and_keywords() -> None:
    setting = SolverSettings("stormer-verlet", "auto*2", {"effects.friction.scheme": "velocity"})
    found = recommend_from_study(study(WorkPrecisionPoint(setting, 1e-3, 1.0, 10)), 1e-2)
    assert found.keywords == {"dt": "auto*2", "method": "stormer-verlet"}
    assert found.changes == {"effects.friction.scheme": "velocity"}
    assert found.command == (
        "python -m granular run scene --set effects.friction.scheme=velocity --dt 'auto*2' "
        "--method stormer-verlet"
    )
    json.dumps(found.to_plain(), allow_nan=False)


def test_errors_of_a_single_grain_decrease_with_the_time_step() -> None:
    """The errors are relative to the exact motion. A run with the recommended setting has the same error."""
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
def test_methods_with_many_force_calls_are_tried_only_at_small_tolerances(
    tolerance: float, tried: bool
) -> None:
    found = recommend_settings(exact_solution.bounce_problem(time=0.3).scene, "energy", tolerance, until=0.3)
    families = {one.setting.family for one in found.study.points}
    assert "stormer-verlet" in families
    assert ("blanes-moan-6" in families) is tried


SEED = MeasuredQuantity("seed", "1", lambda run: float(run.scene.arrangement.seed))


def test_the_error_of_a_setting_is_a_mean_over_starts_and_its_lower_limit_is_their_scatter() -> None:
    """Every setting is run from the same starts. The error of a biased setting has a standard error."""
    bed = load_scene("bed").replace(**{"grains.count": 2})
    verlet = SolverSettings("stormer-verlet", 1e-4)
    found = work_precision(bed, SEED, [verlet], reference=verlet, until=0.001, seeds=3)
    assert found.floor == pytest.approx(np.std([1.0, 2.0, 3.0, 4.0], ddof=1) / 2.5)
    assert (found.points[0].error, found.points[0].doubt, found.points[0].starts) == (0.0, 0.0, 4)
    off = work_precision(bed, SEED, [verlet], reference=2.0, until=0.001, seeds=3).points[0]
    assert off.error == pytest.approx(0.25)  # the mean of 1, 2, 3 and 4 is 2.5
    assert off.doubt == pytest.approx(np.std([1.0, 2.0, 3.0, 4.0], ddof=1) / 2.0 / 2.0)


def test_a_scene_without_random_starts_is_run_once() -> None:
    alone, verlet = load_scene("single-particle"), [SolverSettings("stormer-verlet", 1e-4)]
    assert not scene_depends_on_seed(alone)
    assert scene_depends_on_seed(load_scene("damper"))
    once = work_precision(alone, SEED, verlet, reference=1.0, until=0.001, seeds=3)
    assert once.points[0].starts == 1
    assert once.floor == 0.0


def scattered(starts: int, error: float, doubt: float, steps: int) -> WorkPrecisionPoint:
    return WorkPrecisionPoint(
        SolverSettings("a", f"auto*{1 / steps}"), error, 0.1 * steps, steps, None, doubt, starts
    )


def test_a_tolerance_below_three_times_the_scatter_over_starts_requires_more_starts() -> None:
    """Otherwise the scatter would decide, and any setting might seem accurate enough."""
    points = (scattered(5, 9e-3, 1e-3, 10), scattered(5, 1e-3, 2e-3, 20), scattered(5, 0.0, 2e-3, 40))
    found = study(*points, floor=5e-3)
    advice = found.advise(1e-2)
    assert advice.needs_more_starts
    assert advice.point == points[1]  # the first is clearly biased
    assert advice.starts == 1
    assert found.advise(1e-3).starts == 100
    assert found.advise(1e-3).seconds == pytest.approx(200.0)
    assert "scatter by 0.005 over the starts; the mean of 100 starts takes" in str(found.advise(1e-3))
    assert found.cheapest_point(1e-2) is None
    assert found.cheapest_point(2e-2) == points[0]
    chosen = recommend_from_study(found, 1e-3)
    assert chosen.starts == 100
    assert "over the starts" in str(chosen)
    json.dumps(chosen.to_plain(), allow_nan=False)


def test_an_uncertain_small_error_does_not_meet_the_tolerance() -> None:
    """An error near zero is not sufficient if its standard error exceeds the tolerance."""
    points = (scattered(5, 1e-4, 2e-2, 10), scattered(5, 1e-3, 1e-3, 20))
    assert study(*points, floor=1e-3).cheapest_point(1e-2) == points[1]


MADE = MeasuredQuantity("made", "1", lambda _: 0.0)


def made_study(
    random: np.random.Generator, starts: int, floor: float
) -> tuple[WorkPrecision, dict[str, tuple[float, float]]]:
    """Simulated study: steps of two methods with known biases, and scattered starts."""
    reference = 1.0 + random.normal(0.0, floor, starts)
    points, truth = [], {}
    for method, order, price in (("second", 2, 1.0), ("fourth", 4, 5.0)):
        coarsest = 10.0 ** random.uniform(-4.0, -1.0)
        for k in range(7):
            bias = coarsest * 2.0 ** (-order * k) * random.choice([-1.0, 1.0])
            values = 1.0 + bias + random.normal(0.0, floor, starts)
            error, doubt = error_and_standard_error_over_starts(MADE, list(values), list(reference))
            setting, seconds = SolverSettings(method, f"auto/{2**k}"), price * 2.0**k
            points.append(WorkPrecisionPoint(setting, error, seconds, 2**k, None, doubt, starts))
            truth[f"{method} {setting.dt}"] = abs(bias), seconds
    scatter = float(np.std(reference, ddof=1))
    return WorkPrecision("scene", "made", "1", None, tuple(points), scatter, "made"), truth


@pytest.mark.parametrize("starts", [3, 5])
def test_scatter_over_starts_rarely_leads_to_a_biased_or_slow_setting(starts: int) -> None:
    """In at most 5 % of 200 simulated studies the advised setting is biased, or twice as slow as needed."""
    random, wrong, floor = np.random.default_rng(starts), 0, 1e-3
    for _ in range(200):
        tolerance = floor * 10.0 ** random.uniform(0.5, 2.0)
        found, truth = made_study(random, starts, floor)
        advice = found.advise(tolerance)
        needed = min((s for bias, s in truth.values() if bias <= tolerance), default=math.inf)
        if advice.needs_more_starts:
            continue  # judged by its own starts, and reported
        if advice.point is None:
            wrong += needed < math.inf
            continue
        bias, seconds = truth[f"{advice.point.setting.method} {advice.point.setting.dt}"]
        wrong += bias > tolerance or seconds > 2.0 * needed
    assert wrong <= 10


def test_without_standard_errors_scatter_would_often_lead_to_a_wrong_setting() -> None:
    random, wrong, floor = np.random.default_rng(1), 0, 1e-3
    for _ in range(200):
        tolerance = floor * 10.0 ** random.uniform(0.5, 2.0)
        found, truth = made_study(random, 2, floor)
        bare = [dataclasses.replace(one, doubt=0.0) for one in found.points]
        best = dataclasses.replace(found, points=tuple(bare), floor=0.0).cheapest_point(tolerance)
        if best is not None:
            wrong += truth[f"{best.setting.method} {best.setting.dt}"][0] > tolerance
    assert wrong > 0


@pytest.mark.parametrize(
    ("quantity", "settings", "repeats", "words"),
    [
        ("enrgy", [SolverSettings("stormer-verlet", "auto")], 1, "did you mean 'energy'"),
        ("energy", [], 1, "no settings"),
        ("energy", [SolverSettings("pefrl", "auto")], 0, "repeats = 0"),
    ],
)
def test_invalid_studies_of_cost_and_accuracy_are_refused(
    quantity: str, settings: Any, repeats: int, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        work_precision(load_scene("damper"), quantity, settings, repeats=repeats)


def test_candidate_settings_never_change_the_physics_of_the_scene() -> None:
    """A different friction law was once advised by chance."""
    bed = load_scene("bed").replace(**{"effects.drag": None, "effects.friction": {}})
    smooth = {one.method for one in settings_to_try(load_scene("damper"))}
    assert smooth > {"stormer-verlet", "blanes-moan-4"}
    for scheme in ("velocity", "regularised"):
        found = settings_to_try(bed.replace(**{"effects.friction.scheme": scheme}))
        assert {(one.method, bool(one.changes)) for one in found} == {("stormer-verlet", False)}


@pytest.mark.parametrize(("period", "ratio"), [(0.288, 0.037), (1.0, 0.2), (0.01, 0.001)])
def test_period_and_damping_of_a_damped_oscillation_are_recovered(period: float, ratio: float) -> None:
    omega = 2.0 * math.pi / period / math.sqrt(1.0 - ratio**2)  # so that the period is damped
    time = np.arange(0.0, 12.0 * period, period / 200.0)
    damped = omega * math.sqrt(1.0 - ratio**2)
    height = 0.06 + 1e-3 * np.exp(-ratio * omega * time) * np.cos(damped * time + 0.3)
    found = oscillation_period_and_damping(PistonRecord(time=time, height=height))
    assert found == pytest.approx((period, ratio), rel=1e-3)


FRESH = 5
FIRST = 1001
"""Seed of the first new start, not used by any study."""
REFERENCE = SolverSettings("stormer-verlet", "auto/4")
KNOWN_STARTS = 12


def rubbing() -> Scene:
    """Return a damper of few grains with dry friction.

    The piston has friction too, since sticking grains do not damp its motion.
    """
    changes = {"name": "rubbing", "effects.friction": {}, "piston.friction": "0.5 N"}
    return damper(count=92).replace(**changes)


def runs_of(scene: Scene, **keywords: Any) -> Iterator[Trajectory]:
    """Full runs from new starts."""
    for seed in range(FIRST, FIRST + FRESH):
        yield simulate(scene.replace(**{"arrangement.seed": seed}), progress=False, **keywords)


def errors(scene: Scene, quantity: str, runs: Sequence[Trajectory]) -> list[float]:
    """Return the error of each run, relative to the mean of other starts at a shorter step or to the
    exact value.
    """
    one = QUANTITIES[quantity]
    if one.exact is not None:
        return [one.error(one.measure(run), one.exact) for run in runs]
    others = scenes_with_other_seeds(scene, KNOWN_STARTS - 1)
    (truth,) = scenes_with_reference_values(others, [one], [REFERENCE], None).truth
    mean = sum(truth.values) / len(truth.values)
    return [one.error(one.measure(run), mean) for run in runs]


@pytest.mark.long
@pytest.mark.parametrize(
    ("scene", "quantity", "tolerance"),
    [
        (quarter_bed_compression_scene(), "piston force", 0.03),
        (quarter_bed_compression_scene(), "mean distance", 0.005),
        (quarter_bed_compression_scene(), "energy", 1e-4),
        (rubbing(), "rest height", 0.02),
        (damper(count=92), "rest height", 0.002),
        (damper(count=92), "period", 0.01),
    ],
)
def test_the_recommended_setting_meets_its_tolerance(scene: Scene, quantity: str, tolerance: float) -> None:
    choice = recommend_settings(scene, quantity, tolerance)
    if choice.needs_more_starts:
        assert choice.starts > 1
        return
    runs = list(runs_of(scene.replace(**choice.changes), **choice.keywords))
    assert max(errors(scene, quantity, runs)) <= tolerance


@pytest.mark.long
@pytest.mark.parametrize(
    ("scene", "texts"),
    [
        (quarter_bed_compression_scene(), ["2 % piston force", "0.5 % mean distance", "1e-4 energy"]),
        (damper(count=92), ["2e-3 rest height", "1 % period", "1e-3 energy"]),
        (load_scene("damper"), ["1e-3 rest height", "0.5 % period", "1e-3 energy"]),
    ],
)
def test_runs_with_a_requested_accuracy_reach_this_accuracy(scene: Scene, texts: list[str]) -> None:
    for text in texts:
        tolerance, quantity = parse_tolerance_and_quantity(text)
        assert max(errors(scene, quantity, list(runs_of(scene, accuracy=text)))) <= tolerance, text
