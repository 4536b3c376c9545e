"""Beds with de Paula's friction and a higher initial grid, and an independent implementation of the
time loop.
"""

import numpy as np
import pytest

from granular import simulate
from granular.observables import mean_pair_distance
from research.published.both_causes import final_distance_with_creep_by_step
from research.published.protocols import ACCELERATED, HASTE, PUBLISHED
from research.published.results import EMPTY, read_committed_results
from research.published.series import equal_grain_series
from research.published.start_and_creep import (
    grid_height_changes,
    regularised_friction_settings,
    series_with_both_causes,
)
from research.published.velocity_variants import (
    _fill_forces_and_inverse_cube_sums,
    _piston_height_at,
    half_mean_distances_at_start_and_end,
    half_mean_distances_with_both_causes,
)
from validation.measured_quantities import compression_duration

DIAMETER = 0.006


def test_the_accelerated_compression_cycle_has_the_same_number_of_steps() -> None:
    slow, fast = (series_with_both_causes(92, one) for one in (PUBLISHED, ACCELERATED))
    stages = [one.scene(1).protocol for one in (slow, fast)]
    heights = [one.scene(1).piston.height for one in (slow, fast)]  # type: ignore[union-attr]
    assert heights[0] == heights[1]
    lengths = [some[0].maximum_duration(heights[0]) for some in stages]
    assert lengths[0] == pytest.approx(HASTE * lengths[1])
    assert float(fast.step) == pytest.approx(HASTE * float(slow.step))
    frictions = [one.scene(1).effects.friction for one in (slow, fast)]
    assert frictions[0] == frictions[1]


def test_forces_of_the_independent_loop_agree_with_the_model(random: np.random.Generator) -> None:
    x, y = random.uniform(1.0, 9.0, (2, 7))
    force = np.zeros((3, 7))
    as_written = getattr(
        _fill_forces_and_inverse_cube_sums, "py_func", _fill_forces_and_inverse_cube_sums
    )  # a long test compiles it
    as_written(x, y, 10.0, 10.0, 0.01, force)
    for i in range(7):
        dx, dy = x[i] - np.delete(x, i), y[i] - np.delete(y, i)
        r = np.hypot(dx, dy)
        wall = [0.5 * (one**-3.5 - (10.0 - one) ** -3.5) for one in (x[i], y[i])]
        assert force[0, i] == pytest.approx((0.75 * dx / r**5).sum() + wall[0])
        assert force[1, i] == pytest.approx((0.75 * dy / r**5).sum() + wall[1] - 0.01)
        assert force[2, i] == pytest.approx((1.0 / r**3).sum())


def test_the_piston_of_the_independent_loop_follows_the_cycle() -> None:
    heights = (90.0, 75.0, 20.0)
    times = (0.0, 5.0, 6.0, 7.0, 8.0)
    assert [_piston_height_at(one, heights) for one in times] == pytest.approx([90.0, 75.0, 20.0, 75.0, 75.0])
    assert _piston_height_at(6.5, heights) == pytest.approx(47.5)
    assert _piston_height_at(2.5, heights) > 88.0


@pytest.mark.long
@pytest.mark.parametrize("late", [False, True])
def test_the_independent_loop_reproduces_the_cycle_of_the_toolkit(late: bool) -> None:
    """The time step is so short that no creep occurs, and both velocities in the friction law agree."""
    threshold = regularised_friction_settings(compression_duration(20, PUBLISHED.speed))
    bed = equal_grain_series("", 20, PUBLISHED, speed=0.3, effects__friction=threshold)
    scene = bed.scene(1)
    start, end = half_mean_distances_at_start_and_end(scene, 2e-5, late=late)
    run = simulate(scene, dt=2e-5, progress=False)
    times, places = run.dataset["frame_time"].values, run.dataset["position"].values
    first = int(np.abs(times - run.stage("relax").end).argmin())
    wanted = [0.5 * mean_pair_distance(one) / DIAMETER for one in (places[first], places[-1])]
    assert [start, end] == pytest.approx(wanted, rel=0.02)


def test_a_higher_initial_grid_places_the_top_grains_higher() -> None:
    low, high = (
        equal_grain_series("", 92, PUBLISHED, **grid_height_changes(92, one)).scene(1) for one in (1.0, 1.2)
    )
    tops = [one.initial_positions_and_velocities()[0][:, 1].max() for one in (low, high)]
    assert tops[1] == pytest.approx(1.2 * tops[0], rel=0.05)


def test_committed_creep_of_sticking_grains_increases_with_the_time_step() -> None:
    ends = [one.end.value for one in final_distance_with_creep_by_step(read_committed_results())]
    assert len(ends) == 5
    assert ends == sorted(ends)
    assert final_distance_with_creep_by_step(EMPTY) == []


@pytest.mark.long  # quick: the forces of the loop and the motion of its piston
def test_committed_results_of_the_independent_loop_are_reproduced_within_their_scatter() -> None:
    found = read_committed_results()
    ends = [found.calculated_number("late_velocity", f"{when} 92, 1") for when in ("start", "end")]
    assert half_mean_distances_with_both_causes(92, 1) == pytest.approx(ends, rel=1e-2)
