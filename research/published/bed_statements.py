"""Tests of de Paula's qualitative statements on beds of equal grains [D, chapter 3]."""

from __future__ import annotations

import numpy as np

from research.published.measures import samples_under_common_protocol
from research.published.plan import SIZES, SPEEDS
from research.published.protocols import QUICK
from research.published.results import PublishedResults
from research.published.statement import (
    StatementCheck,
    force_curves_over_mean_maximum_force,
    mean_curve_over_starts,
    means_of_figure_in_two_series,
    packing_fractions_along_stroke,
)


def check_force_grows_exponentially_with_packing(results: PublishedResults) -> StatementCheck | None:
    courses = [mean_curve_over_starts(results, "direct 368", way) for way in ("down", "up")]
    if courses[0] is None or courses[1] is None:
        return None
    rates, fractions = [], []
    for trajectory in (courses[0], courses[1][::-1]):
        packing = packing_fractions_along_stroke(368, trajectory)
        chosen = (packing > 0.12) & (trajectory > 0.0)
        x, y = packing[chosen], np.log(trajectory[chosen])
        rates.append(float(np.polyfit(x, y, 1)[0]))
        fractions.append(float(np.corrcoef(x, y)[0, 1] ** 2))
    return StatementCheck(
        min(fractions) > 0.95 and abs(rates[1] / rates[0] - 1.0) > 0.1,
        f"above a packing of 0.12 the logarithm has the slopes {rates[0]:.0f} and {rates[1]:.0f}, "
        f"R² {fractions[0]:.3f} and {fractions[1]:.3f}",
    )


def check_bed_denser_below_piston(results: PublishedResults) -> StatementCheck | None:
    profiles = np.array(results.figure_lists_by_start("direct 368", "profile_full"))
    if profiles.ndim != 2:
        return None
    mean = profiles.mean(axis=0)
    upper, middle = float(mean[6:9].max()), float(mean[4:6].mean())
    return StatementCheck(
        upper > middle, f"local area fraction {upper:.3f} below the piston, {middle:.3f} half way"
    )


def check_loose_start_changes_force(results: PublishedResults) -> StatementCheck | None:
    result = samples_under_common_protocol(
        ["direct 368", "direct 368, loose start"], "force", results, QUICK.name
    )
    if result is None:
        return None
    item, other = (entry.finding() for entry in result)
    differs = abs(item.value - other.value) > 2.0 * max(item.spread or 0.0, other.spread or 0.0)
    return StatementCheck(differs, f"{item.value:.2f} N standard, {other.value:.2f} N loose")


def check_force_independent_of_speed(results: PublishedResults) -> StatementCheck | None:
    names = ["direct 368", *(f"speed {v:g}" for v in SPEEDS[2:])]
    result = samples_under_common_protocol(names, "force", results)
    if result is None:
        return None
    means = [item.values.mean() for item in result]
    worst = max(abs(item / means[0] - 1.0) for item in means)
    speeds = [SPEEDS[1], *SPEEDS[2:]]
    listed = ", ".join(f"{m:.2f} N at {v:g}" for v, m in zip(speeds, means, strict=True))
    return StatementCheck(bool(worst <= 0.03), f"{listed} mm/s")


def check_distance_curve_independent_of_speed(results: PublishedResults) -> StatementCheck | None:
    names = ["direct 368", *(f"speed {v:g}" for v in SPEEDS[2:])]
    courses = [mean_curve_over_starts(results, name, "half_course_D") for name in names]
    known = [item for item in courses if item is not None]
    if len(known) < len(courses):
        return None
    worst = max(float(np.abs(item - known[0]).max()) for item in known[1:])
    return StatementCheck(
        worst <= 0.5, f"the curves differ by at most {worst:.2f} D from the curve at 8.33 mm/s"
    )


def force_roughness_by_speed_and_text(results: PublishedResults, way: str) -> tuple[list[float], str] | None:
    names = ["direct 368", *(f"speed {v:g}" for v in SPEEDS[2:])]
    result = samples_under_common_protocol(names, f"roughness_{way}", results)
    if result is None:
        return None
    values = [float(item.values.mean()) for item in result]
    speeds = [SPEEDS[1], *SPEEDS[2:]]
    listed = ", ".join(f"{v:.4f} at {s:g}" for s, v in zip(speeds, values, strict=True))
    return values, f"rms roughness over F_max: {listed} mm/s"


def check_roughness_on_way_up_grows_with_speed(results: PublishedResults) -> StatementCheck | None:
    result = force_roughness_by_speed_and_text(results, "up")
    return None if result is None else StatementCheck(result[0][-1] > result[0][0], result[1])


def check_roughness_on_way_down_falls_with_speed(results: PublishedResults) -> StatementCheck | None:
    result = force_roughness_by_speed_and_text(results, "down")
    return None if result is None else StatementCheck(result[0][-1] < result[0][0], result[1])


def check_second_order_torque_barely_changes_force(results: PublishedResults) -> StatementCheck | None:
    """Test forces over their maximum, as de Paula compares them."""
    pair = means_of_figure_in_two_series(results, "force", "starts", "second order")
    usual, second = (
        force_curves_over_mean_maximum_force(results, name) for name in ("starts", "second order")
    )
    if pair is None or usual is None or second is None:
        return None
    between = float(np.abs(second.mean(axis=0) - usual.mean(axis=0)).max())
    within = float(np.abs(usual - usual.mean(axis=0)).max())
    return StatementCheck(
        between <= within,
        f"F/F_max differs by at most {between:.3f}, single starts from their mean by "
        f"{within:.3f}; F_max itself is {pair[0]:.2f} N to first and {pair[1]:.2f} N to second "
        "order",
    )


def check_second_order_torque_slightly_increases_hysteresis(
    results: PublishedResults,
) -> StatementCheck | None:
    pair = means_of_figure_in_two_series(results, "hysteresis_D", "starts", "second order")
    if pair is None:
        return None
    return StatementCheck(
        pair[0] < pair[1] < 1.2 * pair[0], f"{pair[0]:.2f} D to first, {pair[1]:.2f} D to second"
    )


def check_high_friction_increases_hysteresis(results: PublishedResults) -> StatementCheck | None:
    pair = means_of_figure_in_two_series(results, "hysteresis_D", "starts", "second order, 0.8")
    if pair is None:
        return None
    return StatementCheck(
        pair[1] > 1.2 * pair[0], f"{pair[0]:.2f} D with 0.6 and 0.45, {pair[1]:.2f} D with 0.8"
    )


def check_high_friction_changes_way_up_more(results: PublishedResults) -> StatementCheck | None:
    usual, high = (
        force_curves_over_mean_maximum_force(results, name) for name in ("starts", "second order, 0.8")
    )
    if usual is None or high is None:
        return None
    gap = np.abs(high.mean(axis=0) - usual.mean(axis=0))
    down, up = float(gap[: len(gap) // 2].max()), float(gap[len(gap) // 2 :].max())
    return StatementCheck(up > down, f"F/F_max differs by {down:.3f} down and {up:.3f} up")


def check_force_grows_with_friction(results: PublishedResults) -> StatementCheck | None:
    names = ["drag", "starts", "second order, 0.8"]
    result = samples_under_common_protocol(names, "force", results)
    if result is None:
        return None
    means = [float(item.values.mean()) for item in result]
    words = "without friction (drag), usual, 0.8: " + ", ".join(f"{item:.2f} N" for item in means)
    return StatementCheck(means == sorted(means), words)


def check_sizes_share_force_curve_over_stroke(results: PublishedResults) -> StatementCheck | None:
    courses = mean_compression_force_curve_of_each_size(results)
    if courses is None:
        return None
    late = np.array([item[int(0.75 * (len(item) - 1)) :] / item[-1] for item in courses])
    worst = float(np.ptp(late, axis=0).max())
    return StatementCheck(worst <= 0.05, f"there the sizes differ by at most {worst:.3f}")


def check_sizes_share_force_curve_over_packing(results: PublishedResults) -> StatementCheck | None:
    courses = mean_compression_force_curve_of_each_size(results)
    if courses is None:
        return None
    grid = np.linspace(0.14, 0.24, 41)
    rows = [
        np.interp(grid, packing_fractions_along_stroke(n, item), item / item[-1])
        for n, item in zip(SIZES, courses, strict=True)
    ]
    worst = float(np.ptp(rows, axis=0).max())
    return StatementCheck(worst <= 0.05, f"there the sizes differ by at most {worst:.3f}")


def mean_compression_force_curve_of_each_size(results: PublishedResults) -> list[np.ndarray] | None:
    courses = [mean_curve_over_starts(results, f"direct {n}", "down") for n in SIZES]
    known = [item for item in courses if item is not None]
    return known if len(known) == len(courses) else None


def check_force_smoother_in_larger_beds(results: PublishedResults) -> StatementCheck | None:
    result = samples_under_common_protocol([f"direct {n}" for n in SIZES], "roughness_down", results)
    if result is None:
        return None
    values = [float(item.values.mean()) for item in result]
    listed = ", ".join(f"{v:.4f} (N = {n})" for n, v in zip(SIZES, values, strict=True))
    return StatementCheck(values[-1] < values[0], f"rms roughness over F_max: {listed}")


def check_hysteresis_grows_with_size(results: PublishedResults) -> StatementCheck | None:
    result = samples_under_common_protocol([f"direct {n}" for n in SIZES], "hysteresis_D", results)
    if result is None:
        return None
    values = [float(item.values.mean()) for item in result]
    listed = ", ".join(f"{v:.2f}" for v in values)
    return StatementCheck(values[-1] > values[0], f"{listed} D for N = 92 to 736")


def check_slab_walls_cannot_carry_bed(results: PublishedResults) -> StatementCheck | None:
    result = samples_under_common_protocol(["slabs", "slabs"], "lowest_start_D", results)
    loads = samples_under_common_protocol(["slabs", "slabs"], "bottom_start", results)
    weights = samples_under_common_protocol(["slabs", "slabs"], "weight", results)
    if result is None or loads is None or weights is None:
        return None
    lowest, load = float(result[0].values.min()), float(loads[0].values.mean())
    weight = float(weights[0].values.mean())
    return StatementCheck(
        not (lowest > 0.0 and load > 0.0),
        f"here they can: the lowest grain is {lowest:.2f} D above the bottom, which carries "
        f"{load:.2f} N before the compression (weight {weight:.2f} N)",
    )


def check_infinite_walls_change_force(results: PublishedResults) -> StatementCheck | None:
    result = samples_under_common_protocol(
        ["direct 368", "infinite walls", "slabs"], "force", results, QUICK.name
    )
    if result is None:
        return None
    usual, infinite, slabs = (item.finding() for item in result)
    differs = abs(infinite.value - usual.value) > 3.0 * (usual.spread or 0.0)
    return StatementCheck(
        differs,
        f"{usual.value:.2f} N with the experimental law, {infinite.value:.2f} N with infinite "
        f"walls, {slabs.value:.2f} N with slabs",
    )
