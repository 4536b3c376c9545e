"""De Paula's test of the integration method: compensated sums have order two, and the position form shows
rounding errors.
"""

import numpy as np
import pytest

from granular import simulate
from granular.schema.natural_units import Scales
from validation import exact_solution
from validation.depaula_step_test import (
    COMPENSATED,
    PLAIN,
    STEPS,
    TOOLKIT,
    DepaulaStepTest,
    _final_height_and_peak_count_by_compensated_form,
    _final_height_and_peak_count_by_position_form,
    _run_depaula_form,
    _run_toolkit_method,
    run_depaula_step_test,
)


def forms(*steps: float) -> DepaulaStepTest:
    exact = float(exact_solution.bounce_problem().exact(exact_solution.TIME).positions[0, 1])
    return DepaulaStepTest(
        tuple(_run_depaula_form(form, step, exact) for form in (PLAIN, COMPENSATED) for step in steps)
    )


@pytest.fixture(scope="module")
def coarse() -> DepaulaStepTest:
    return forms(*STEPS[:4])


def test_verlet_with_compensated_sums_converges_with_order_two(coarse: DepaulaStepTest) -> None:
    assert coarse.error_slope(COMPENSATED) == pytest.approx(2.0, abs=0.01)
    assert all((one.peak_height_range or 1.0) < 1e-12 for one in coarse.runs_of_form(COMPENSATED))


def test_errors_of_the_position_form_are_rounding_errors(coarse: DepaulaStepTest) -> None:
    """The error grows as the step shrinks, and equals the difference between the forms with and without
    compensation.
    """
    for one in coarse.runs_of_form(PLAIN):
        assert coarse.rounding_errors()[one.step] == pytest.approx(one.error, rel=0.1)
    assert coarse.runs_of_form(PLAIN)[-1].error > 1e4 * coarse.runs_of_form(COMPENSATED)[-1].error


def test_peaks_and_path_of_a_bouncing_grain_agree_with_the_exact_motion(coarse: DepaulaStepTest) -> None:
    """It has four peaks within 2 s, as high as the starting height."""
    problem, length = exact_solution.bounce_problem(), len(coarse.runs[0].path)
    heights = {k: problem.exact(k * exact_solution.TIME / length).positions[0, 1] for k in (0, 19, 42, 137)}
    for one in coarse.runs:
        assert len(one.peaks) == 4
        assert np.abs(one.peaks).max() < 1e-8
        assert len(one.path) == length
        for k, exact in heights.items():
            clear = 1e-9 if one.form == COMPENSATED else 1e-5  # rounding of the position form
            assert one.path[k] == pytest.approx(exact, abs=clear)


def test_position_form_and_velocity_form_give_the_same_sequence() -> None:
    """The heights by de Paula's position form and by the toolkit agree beyond the first bounce."""
    scales, step, count = Scales.from_grains(exact_solution.bounce_problem().scene.grains), 1e-4, 3000
    problem = exact_solution.bounce_problem(time=count * step)
    gravity = problem.scene.effects.gravity
    start = (float(exact_solution.START), gravity.acceleration / scales.acceleration)
    plain, _ = _final_height_and_peak_count_by_position_form(
        *start, step / scales.time, count, np.zeros(4), np.zeros(4)
    )
    clean, _ = _final_height_and_peak_count_by_compensated_form(
        *start, step / scales.time, count, np.zeros(4), np.zeros(4)
    )
    exact = float(problem.exact(problem.time).positions[0, 1])
    for method, height in (("stormer-verlet", plain), ("stormer-verlet+compensated", clean)):
        run = simulate(problem.scene, step, problem.time, method, progress=False)
        found = float(run.dataset["position"].values[-1, 0, 1])
        assert run.settings()["steps"] == count
        assert abs(found - height * scales.length) < 1e-5 * abs(found - exact)


def test_compensated_sums_remove_the_rounding_error() -> None:
    """After two million compensated steps of the toolkit only the truncation error remains."""
    exact = float(exact_solution.bounce_problem().exact(exact_solution.TIME).positions[0, 1])
    clean = _run_toolkit_method(1e-6, exact)
    form = _run_depaula_form(COMPENSATED, 1e-6, exact)
    assert clean.end == pytest.approx(form.end, rel=1e-13)


@pytest.mark.long
def test_the_full_experiment_shows_order_two_and_the_published_rounding_error() -> None:
    found = run_depaula_step_test(full=True)
    for form in (COMPENSATED, TOOLKIT):
        assert found.error_slope(form) == pytest.approx(2.0, abs=0.01)
    finest = found.runs_of_form(COMPENSATED)[-1]
    assert finest.step == 1e-8
    assert finest.peak_height_range is not None
    assert finest.peak_height_range <= 1e-12
    assert found.runs_of_form(TOOLKIT)[-1].step == 1e-8
    printed = found.runs_of_form(PLAIN)[-1].peak_height_range
    assert printed is not None
    assert 1e-9 < printed < 1e-7  # rounding, of the size printed by de Paula
