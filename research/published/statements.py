"""Qualitative statements of de Paula, tested on the runs."""

from __future__ import annotations

from research.published import bed_statements as bed
from research.published import damper_statements as damper
from research.published import mixture_statements as mixture
from research.published.results import PublishedResults
from research.published.statement import Statement


def all_statements() -> tuple[Statement, ...]:
    """Return all statements, in the order of the thesis."""
    return (
        Statement(
            "3.1",
            "the force grows exponentially with the packing, down and up with different rates (Fig. 3.1)",
            bed.check_force_grows_exponentially_with_packing,
        ),
        Statement(
            "3.1",
            "close to the piston the fully compressed bed is denser than at half height (Fig. 3.2)",
            bed.check_bed_denser_below_piston,
        ),
        Statement(
            "3.1",
            "a loose start gives another force than a standard one",
            bed.check_loose_start_changes_force,
        ),
        Statement(
            "3.3",
            "the force does not depend on the piston's speed, 8.33 to 128 mm/s",
            bed.check_force_independent_of_speed,
        ),
        Statement(
            "3.3",
            "nor does the curve of the mean distance (Fig. 3.4b)",
            bed.check_distance_curve_independent_of_speed,
        ),
        Statement(
            "3.3",
            "on the way up the force oscillates more at higher speeds",
            bed.check_roughness_on_way_up_grows_with_speed,
        ),
        Statement(
            "3.3",
            "on the way down it jumps more at lower ones",
            bed.check_roughness_on_way_down_falls_with_speed,
        ),
        Statement(
            "3.4",
            "torque of second order changes F/F_max no more than another start",
            bed.check_second_order_torque_barely_changes_force,
        ),
        Statement(
            "3.4",
            "it slightly increases the hysteresis of the mean distance",
            bed.check_second_order_torque_slightly_increases_hysteresis,
        ),
        Statement(
            "3.4",
            "high friction (0.8) strongly increases the hysteresis of the mean distance",
            bed.check_high_friction_increases_hysteresis,
        ),
        Statement(
            "3.4",
            "high friction changes the way up more than the way down (Fig. 3.5)",
            bed.check_high_friction_changes_way_up_more,
        ),
        Statement(
            "3.4, 4.3.1",
            "higher friction needs a larger force at the same packing",
            bed.check_force_grows_with_friction,
        ),
        Statement(
            "3.5",
            "F/F_max is the same for all sizes from 0.75 of the stroke on (Fig. 3.9)",
            bed.check_sizes_share_force_curve_over_stroke,
        ),
        Statement(
            "3.5", "and from a packing of 0.14 on (Fig. 3.10)", bed.check_sizes_share_force_curve_over_packing
        ),
        Statement(
            "3.5", "the force curve is smoother in larger beds", bed.check_force_smoother_in_larger_beds
        ),
        Statement(
            "3.5",
            "the hysteresis of the mean distance grows with the bed",
            bed.check_hysteresis_grows_with_size,
        ),
        Statement("3.6", "slabs as walls cannot carry the bed", bed.check_slab_walls_cannot_carry_bed),
        Statement(
            "3.6",
            "infinite walls do not give the force of the experimental law",
            bed.check_infinite_walls_change_force,
        ),
        Statement(
            "4.3.1",
            "F/F_max over the packing is the same for every mixture (Fig. 4.7)",
            mixture.check_mixtures_share_force_curve_over_packing,
        ),
        Statement("4.3.1", "F_max grows with R", mixture.check_force_grows_with_big_grain_fraction),
        Statement("4.3.1", "F_max grows as a falls", mixture.check_force_grows_as_aspect_ratio_falls),
        Statement(
            "4.3.1",
            "F(R)/F(1) lies on the printed curves of Table 4.5",
            mixture.check_forces_lie_on_published_curves,
        ),
        Statement(
            "4.3.1",
            "at R = 0.5 the grain nearest to the piston is a small one",
            mixture.check_grain_nearest_to_piston_is_small,
        ),
        Statement(
            "4.3.2",
            "the fraction of hexagons falls with a",
            mixture.check_hexagon_fraction_falls_with_aspect_ratio,
        ),
        Statement(
            "4.3.2",
            "pure beds are ordered, mixtures near R = 0.5 have the lowest order",
            mixture.check_order_is_lowest_in_half_mixtures,
        ),
        Statement(
            "4.3.2", "R = 0 and R = 1 are similar", mixture.check_pure_beds_have_similar_hexagon_fractions
        ),
        Statement(
            "4.2.4",
            "g(r) is periodic: there is long-range order",
            mixture.check_pure_beds_have_long_range_order,
        ),
        Statement(
            "4.3.3",
            "drag and weightlessness change the force little",
            mixture.check_drag_and_weightlessness_barely_change_force,
        ),
        Statement(
            "4.3.4",
            "two mixtures of a = 0.75, of 5 and of 8 mm, have the same F(R)/F(1)",
            mixture.check_grain_sizes_share_relative_force_curve,
        ),
        Statement(
            "4.3.5",
            "small grains feel smaller forces than big ones",
            mixture.check_small_grains_feel_smaller_forces,
        ),
        Statement(
            "4.3.5",
            "forces on grains have two modes at R = 0.5 (Fig. 4.22)",
            mixture.check_grain_forces_of_half_mixtures_have_two_modes,
        ),
        Statement(
            "4.3.5",
            "and one at R = 0 and R = 1 (Fig. 4.21 for R = 0)",
            mixture.check_grain_forces_of_pure_beds_have_one_mode,
        ),
        Statement(
            "4.3.5",
            "half of the grains belong to either mode (Fig. 4.22)",
            mixture.check_small_grains_form_lower_force_mode,
        ),
        Statement(
            "4.3.5",
            "resulting forces prefer no direction (Fig. 4.23)",
            mixture.check_forces_prefer_no_direction,
        ),
        Statement("4.3.5", "there are no chains of forces (Fig. 4.24)", mixture.check_forces_form_no_chains),
        Statement(
            "4.3.1",
            "two starts under de Paula's friction differ by at most 0.2 N",
            mixture.check_two_starts_agree_under_source_friction,
        ),
        Statement(
            "5.2.1",
            "symbolic regression finds z(t) of a damped oscillator",
            damper.check_symbolic_regression_finds_oscillator,
        ),
        Statement(
            "5.3.1",
            "the Van der Pol-like law follows the oscillation better than the linear one",
            damper.check_van_der_pol_like_law_beats_linear_law,
        ),
        Statement(
            "5.3.1",
            "at a drag of the grains that de Paula prints (0.1 kg/s)",
            damper.check_van_der_pol_like_law_beats_linear_law_at_printed_drag,
        ),
        Statement(
            "4.3.2, experiment",
            "scattered moments make R near 1 less ordered",
            damper.check_scattered_moments_reduce_order,
        ),
    )


def count_statements_by_outcome(results: PublishedResults) -> dict[str, int]:
    """Return the numbers of statements that hold, do not hold, and were not run."""
    result = [item.check(results) for item in all_statements()]
    return {
        "hold": sum(item is not None and item.holds for item in result),
        "do not hold": sum(item is not None and not item.holds for item in result),
        "not run": sum(item is None for item in result),
    }
