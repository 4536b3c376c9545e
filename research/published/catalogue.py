"""List of all published numbers that are compared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache, partial

from research.published.calculations import HEIGHTS
from research.published.entry import PLAIN, UNEXPLAINED, Entry, VerdictRule
from research.published.measures import (
    ForceOverSizeLine,
    Measure,
    make_asymptotic_list_loss_measure,
    make_calculation_measure,
    make_force_deviation_measure,
    make_force_over_published_curve_measure,
    make_list_force_loss_measure,
    make_maximum_equal_force_speed_measure,
    make_maximum_relative_force_deviation_measure,
    make_maximum_start_difference_measure,
    make_mean_measure,
    make_minimum_measure,
    make_order_correlation_measure,
    make_smallest_sufficient_radius_measure,
    make_time_exponent_measure,
    make_time_saving_measure,
)
from research.published.plan import (
    ASPECTS,
    LARGE,
    LISTED,
    MASSES,
    RADII,
    RATIOS,
    SIZES,
    SOURCE_DRAG,
    SPEEDS,
    VARIANT_RATIOS,
    VARIANTS,
    damper_series_name,
    mixture_series_name,
)
from validation.measured_quantities import published_value

OWN_TERMS = VerdictRule(comparable=False)
MADE = VerdictRule(constructed=True)
THREE, TEN_STARTS = VerdictRule(draws=3), VerdictRule(draws=10)
"""Places in the thesis with the number of runs behind numbers without a deviation."""

ALL_SIZES = LISTED + LARGE
ASPECT_NAMES = ("0.75", "0.6", "0.5", "0.75 (6:8)")

OTHER_MACHINE = (
    "Times depend on machine and code. Here a loop over all pairs and a loop over a list are compared, "
    "written as plainly as in the thesis; the toolkit's direct sum processes eight pairs simultaneously, "
    "and is faster than both at this size."
)
SCALED_BY_EYE = (
    "De Paula compares by eye. In that scaling (z = 1 at the start, rest at z = -0.907) a fit to the "
    "oscillation gives these values; no unit of time is printed. alpha/omega and g0/omega² do not need a "
    "unit."
)
UNIT = "In 1/s. A unit of time of 0.038 s would make it 1.05, which the thesis does not have."
HYSTERESIS = (
    "De Paula's friction at its step makes grains creep, which widens the bed at the end, and the first "
    "grid, whose height is not printed, changes the start. Both causes together reproduce the value or come "
    "close to it; see Causes."
)
ROUNDED_CELL = (
    "In a cell whose scale, the root of 1/2, is rounded to 0.70 the minimum is 7.56 D and the start 11.27 "
    "D; with the fitted height of the first grid the start is also lower. See Causes."
)
SAME_FORCE = (
    f"{UNEXPLAINED}other speeds, a third of the step, de Paula's friction at its step (15.3 N in "
    "three starts) and a higher first grid. Table 3.2 prints the same 15.26 N for three starts at "
    "another speed."
)
FROM_FIGURE = f"{UNEXPLAINED}ten starts here; the thesis gives about 0.02, from its figure."
TWO_STARTS = (
    f"{UNEXPLAINED}both protocols, and thirty pairs of starts: two starts of one mixture differ by about a "
    f"hundredth of the force, as in the thesis's Table 3.2. The thesis does not give its number of pairs."
)
LOST_PAIRS = (
    f"{UNEXPLAINED}lists of seven radii: a list of 11.26 D must lose about 4 % at this density, as it does "
    f"here; the printed 0.48 % is the difference of two means with deviations of 0.24 and "
    "0.11 N."
)
OWN_LINE = "Misprint or rounding: the line through the printed forces has R² = 0.998."
FROM_DEVIATION = (
    "The printed 0.001 contradicts the 0.24 N of the thesis's Table 3.2; ours agrees with the latter."
)


@cache
def all_entries() -> tuple[Entry, ...]:
    """Return all entries, in the order of the thesis."""
    return (
        *_grain_constant_entries(), *_bouncing_grain_entries(), *_independence_of_start_entries(),
        *_mean_distance_entries(), *_direct_sum_force_entries(), *_verlet_list_force_entries(),
        *_pair_sum_time_entries(), *_polygon_fraction_entries(), *_half_mixture_entries(),
        *_order_correlation_entries(), *_biexponential_force_entries(), *_damper_entries(),
    )  # fmt: skip


def _grain_constant_entries() -> list[Entry]:
    grain = "default_grain"
    return [
        Entry(f"{grain}.mass_kg", "mass of a grain", make_calculation_measure(grain, "mass_kg"), "kg", MADE,
              digits=6),
        Entry(f"{grain}.moment_A_m2", "magnetic moment of a grain",
              make_calculation_measure(grain, "moment_A_m2"), "A m²", MADE, digits=5),
        Entry(f"{grain}.distance_where_force_is_weight", "distance at which the pair force equals the weight",
              make_calculation_measure(grain, "distance_where_force_is_weight"), "D"),
        Entry("walls.slab_exponent", "mean exponent of the slab's force",
              make_calculation_measure("slab_exponent", "exponent"), digits=3,
              note="The weights of the points determine the third decimal: fitted to logarithms the same "
                   "points give -3.10."),
        Entry("bidisperse_further.packing_fraction", "packing fraction of the mixtures, all R",
              make_calculation_measure("packing", "packing_fraction"), rule=MADE),
        _final_height_entry(),
    ]  # fmt: skip


def _final_height_entry() -> Entry:
    """Return one entry for one formula, [D, eq. 4.23]: all sixty-two rows follow from it."""
    first, *rest = (
        f"final_height.{name}[{k}]" for name, (_, _, ratios) in HEIGHTS.items() for k in range(len(ratios))
    )
    return Entry(first, f"final piston height, {1 + len(rest)} rows of one formula",
                 make_calculation_measure("final_heights", "three_fifths[0]"), "D", MADE, digits=5,
                 covers=tuple(rest))  # fmt: skip


def _bouncing_grain_entries() -> list[Entry]:
    return [
        Entry("single_particle.slope", "order of Störmer-Verlet on the bouncing grain",
              make_calculation_measure("single_particle", "slope"), digits=0),
        Entry("single_particle.greatest_peak_difference_m", "maximum difference of two peaks, position form",
              make_calculation_measure("single_particle", "peak_difference"), "m",
              rule=OWN_TERMS, digits=10,
              note="Rounding of the position form, whose last digits depend on the order of each sum; with "
                   "compensated sums the peaks differ by about 1e-15 m."),
    ]  # fmt: skip


def _independence_of_start_entries() -> list[Entry]:
    name = "independence_of_start"
    return [
        Entry(f"{name}.force_mean", "maximum piston force, mean of ten starts",
              make_mean_measure("starts", "force"), "N", TEN_STARTS,
              note=SAME_FORCE),
        Entry(f"{name}.std_at_max_as_printed", "its standard deviation",
              make_force_deviation_measure("starts"), "N", digits=3, note=FROM_DEVIATION),
        Entry(f"{name}.std_over_mean_anywhere", "maximum deviation in the cycle, over the mean maximum force",
              make_maximum_relative_force_deviation_measure("starts"),
              note=FROM_FIGURE),
        Entry("velocity.greatest_speed_mm_s", "maximum speed with the force of 8.33 mm/s, within 3 %",
              make_maximum_equal_force_speed_measure(SPEEDS[2:], "direct 368", 0.03), "mm/s",
              VerdictRule(limit="least"), digits=0,
              note="Faster pistons press on a bed that has had no time to relax."),
    ]  # fmt: skip


def _mean_distance_entries() -> list[Entry]:
    name = "half_mean_distance"
    notes = {
        92: "De Paula starts the smallest bed from a larger height, which is not given. " + HYSTERESIS,
        184: ROUNDED_CELL,
    }
    columns = (
        ("minimum", "half_full_D", "at full compression"),
        ("start", "half_start_D", "at the start"),
        ("end", "half_end_D", "at the end (t = 3 T)"),
    )
    rows = [
        Entry(f"{name}.{column}[{k}]", f"half mean distance {when}, N = {n}",
              _measure_with_deviation_pooled_over_sizes(n, figure),
              "D", note=notes.get(n, HYSTERESIS))
        for k, n in enumerate(SIZES)
        for column, figure, when in columns
    ]  # fmt: skip
    return rows + _hysteresis_entries()


def _measure_with_deviation_pooled_over_sizes(count: int, figure: str) -> Measure:
    """Return the measure of a figure of a bed, with the pooled deviation of beds of all sizes."""
    return make_mean_measure(f"direct {count}", figure, pool=[f"direct {n}" for n in SIZES])


def _hysteresis_entries() -> list[Entry]:
    columns = (
        ("start_over_minimum", "start_over_full", "start over full compression", ""),
        ("end_over_minimum", "end_over_full", "end over full compression", ""),
        ("hysteresis", "hysteresis_D", "start minus end", "D"),
        ("hysteresis_over_minimum", "hysteresis_over_full",
         "start minus end, over full compression", ""),
    )  # fmt: skip
    return [
        Entry(f"hysteresis_of_distance.{column}[{k}]", f"half mean distance, {words}, N = {n}",
              _measure_with_deviation_pooled_over_sizes(n, figure), unit, note=HYSTERESIS)
        for k, n in enumerate(SIZES)
        for column, figure, words, unit in columns
    ]  # fmt: skip


def _force_entries_by_size(name: str, series: str, words: str) -> list[Entry]:
    return [
        Entry(f"{name}.mean[{k}]", f"piston force, {words}, N = {n}",
              make_mean_measure(f"{series} {n}", "force"), "N", spread_key=f"{name}.std[{k}]",
              note=LARGE_FORCES if n in LARGE else "")
        for k, n in enumerate(ALL_SIZES)
    ]  # fmt: skip


def _direct_sum_force_entries() -> list[Entry]:
    name = "piston_force_direct_sum"
    line = ForceOverSizeLine("direct", LISTED)
    rows = _force_entries_by_size(name, "direct", "every pair")
    fits = "piston_force_verlet.linear_fit_direct"
    return [
        *rows,
        Entry(f"{fits}.slope", "slope of force over N, every pair", line.slope, "N", digits=4),
        Entry(f"{fits}.intercept", "intercept, every pair", line.intercept, "N"),
        Entry("mono_further.r_squared_direct", "R² of that line", line.r_squared, digits=3,
              note=OWN_LINE),
    ]  # fmt: skip


def _verlet_list_force_entries() -> list[Entry]:
    name = "piston_force_verlet"
    line = ForceOverSizeLine("list", LISTED)
    rows = _force_entries_by_size(name, "list", "de Paula's list")
    rows += [
        Entry(f"{name}.percent_difference[{k}]", f"loss by the list, N = {n}",
              make_list_force_loss_measure(n), "%", THREE if n in LISTED else PLAIN,
              note=LOST_PAIRS if n == 368 else "")
        for k, n in enumerate(ALL_SIZES)
    ]  # fmt: skip
    fits = f"{name}.linear_fit_verlet"
    return [
        *rows,
        Entry(f"{fits}.slope", "slope of force over N, list", line.slope, "N", digits=4),
        Entry(f"{fits}.intercept", "intercept, list", line.intercept, "N"),
        Entry("mono_further.r_squared_verlet", "R² of that line", line.r_squared, note=OWN_LINE),
        Entry("mono_further.asymptote_percent", "loss by the list in a very large bed, from both lines",
              make_asymptotic_list_loss_measure(ForceOverSizeLine("direct", LISTED), line), "%", digits=1),
    ]  # fmt: skip


def _pair_sum_time_entries() -> list[Entry]:
    name = "piston_force_verlet"
    return [
        Entry(f"{name}.time_exponent", "exponent of the plain list's time over N",
              make_time_exponent_measure(LISTED, "list"), note=OTHER_MACHINE),
        Entry("algorithm.direct_exponent", "exponent of the plain loop's time over N",
              make_time_exponent_measure(LISTED, "direct"), digits=1, note=OTHER_MACHINE),
        Entry(f"{name}.time_saving_at_368", "time saved by the plain list, N = 368",
              make_time_saving_measure(368), rule=OWN_TERMS, note=OTHER_MACHINE),
        Entry("algorithm.first_radius_inside",
              "smallest list radius with a force within a deviation of the direct sum's",
              make_smallest_sufficient_radius_measure(RADII, "direct 368"), "D",
              note="The choice depends on the deviation of three starts."),
        *(
            Entry(f"{name}.direct_sum_hours_at_{n}", f"hours of the direct sum, N = {n}",
                  make_mean_measure(f"direct {n}", "seconds", 1.0 / 3600.0), "h", OWN_TERMS,
                  note="The same protocol with different steps, code and machine.")
            for n in (368, 736)
        ),
    ]  # fmt: skip


def _polygon_fraction_entries() -> list[Entry]:
    rows = []
    for section, way in (("direct_sum", "direct"), ("verlet", "list")):
        name = f"voronoi_shares_{section}"
        for k, n in enumerate(LISTED):
            for kind in ("pentagons", "hexagons", "heptagons"):
                what = f"fraction of {kind}, {'every pair' if way == 'direct' else 'list'}, N = {n}"
                measure = make_mean_measure(f"{way} {n}", f"{kind}_full")
                key, spread = f"{name}.{kind}[{k}]", f"{name}.{kind}_std[{k}]"
                rows.append(Entry(key, what, measure, "", spread_key=spread))
    return rows


def _half_mixture_entries() -> list[Entry]:
    name = "bidisperse_r_half"
    rows = [
        Entry(f"{name}.least_piston_distance[{k}]", f"smallest distance to the piston, a = {a:g}",
              make_mean_measure(mixture_series_name(a, 0.5), "least_distance_D"), "D", note=LEAST)
        for k, a in enumerate(ASPECTS)
    ]  # fmt: skip
    for when, figure in (("start", "start"), ("end", "full")):
        for k, a in enumerate(ASPECTS):
            bed, words = mixture_series_name(a, 0.5), f"at the {when} of the compression, a = {a:g}"
            rows += [
                Entry(f"{name}.hexagon_regularity_{when}[{k}]", f"hexagon regularity {words}",
                      make_mean_measure(bed, f"regularity_{figure}"), "", note=REGULAR),
                Entry(f"{name}.hexagon_regularity_{when}_std[{k}]", "its deviation over the "
                      f"hexagons {words}", make_mean_measure(bed, f"regularity_deviation_{figure}"), "",
                      note=REGULAR),
            ]  # fmt: skip
    zero, bed = "bidisperse_r_zero.hexagon_regularity", mixture_series_name(0.6, 0.0)
    for when, figure in (("start", "start"), ("end", "full")):
        rows += [
            Entry(f"{zero}_{when}", f"hexagon regularity at the {when}, R = 0",
                  make_mean_measure(bed, f"regularity_{figure}"), "", note=REGULAR),
            Entry(f"bidisperse_further.hexagon_regularity_{when}_std_r_zero",
                  f"its deviation at the {when}, R = 0",
                  make_mean_measure(bed, f"regularity_deviation_{figure}"), "", note=REGULAR),
        ]  # fmt: skip
    beds = [mixture_series_name(a, r) for a in ASPECTS for r in RATIOS[1:]]
    return [
        *rows,
        Entry("bidisperse_further.greatest_force_difference",
              "maximum force difference of two starts of one mixture",
              make_maximum_start_difference_measure(beds), "N", digits=1,
              note=TWO_STARTS),
    ]  # fmt: skip


LEAST = (
    "De Paula's friction law at its own step, and the cell of 0.36 m that its Table 4.3 prints, "
    "while text and Table A.1 have 0.33 m, change this distance; see Causes. A cell of 0.36 m "
    "contradicts the packing of 0.34."
)
RATIO = (
    f"{UNEXPLAINED}de Paula's friction law, which changes it in the other direction, its mixing rule, and "
    f"the wide cell; see Causes."
)
LARGE_FORCES = (
    f"{UNEXPLAINED}de Paula's friction at its step with the fitted first grid: the deviation of one start "
    f"of 1472 grains is then a third as large, but 736 grains keep their force. The values for every pair "
    f"are from one run, and the values for the list, from three, are high by about the same: a common cause "
    f"is likely. The contribution of friction to the force grows with N: half the friction lowers the force "
    f"by 12 % at 368 grains and 17 % at 736."
)
REGULAR = (
    "With de Paula's regularised friction at its step (1e-6 T) grains creep, while the exact law holds "
    "them; see Causes."
)


def _order_correlation_entries() -> list[Entry]:
    def order_correlation_over_big_grain_fractions(aspect: float, big: float = 0.005) -> Measure:
        return make_order_correlation_measure([mixture_series_name(aspect, r, big) for r in RATIOS])

    variants = [
        make_order_correlation_measure([f"{name}, R = {r:g}" for r in VARIANT_RATIOS]) for name in VARIANTS
    ]
    return [
        *(
            Entry(f"bidisperse_all_r.psi6_n6_correlation[{k}]", "correlation of Psi6 and the "
                  f"fraction of hexagons, a = {a:g}", order_correlation_over_big_grain_fractions(a), digits=3)
            for k, a in enumerate(ASPECTS)
        ),
        Entry("bidisperse_variants.least_correlation",
              "the same: minimum over variants and the 6 and 8 mm mixture",
              make_minimum_measure([*variants, order_correlation_over_big_grain_fractions(0.75, 0.008)]),
              rule=VerdictRule(limit="least")),
    ]  # fmt: skip


def _biexponential_force_entries() -> list[Entry]:
    """Return the entries of [D, Table 4.5]: the four numbers of a fit are judged as one curve."""
    rows = []
    for k, label in enumerate(ASPECT_NAMES):
        aspect, big = (0.75, 0.008) if k == 3 else (float(label), 0.005)
        beds = [mixture_series_name(aspect, r, big) for r in RATIOS]
        numbers = [f"biexponential_fmax.{name}[{k}]" for name in CURVE]
        covers = (*numbers[1:], f"fmax_over_r.at_zero[{k}]", f"fmax_over_r.at_half[{k}]")
        measure = make_force_over_published_curve_measure(
            partial(_published_biexponential_value, numbers), RATIOS, beds
        )
        words = f"F(R)/F(1) over the printed curve at the maximum difference, a = {label}"
        rows.append(Entry(numbers[0], words, measure, rule=VerdictRule(looks=len(RATIOS) - 1), digits=3,
                          covers=covers, note=RATIO, reference=1.0))  # fmt: skip
    return rows


CURVE = ("A", "lambda1", "B", "lambda2")


def _published_biexponential_value(keys: Sequence[str], ratio: float) -> float:
    a, slow, b, fast = (float(published_value(key)) for key in keys)
    return a * math.exp(slow * ratio) + b * math.exp(fast * ratio)


def _damper_entries() -> list[Entry]:
    law = "damper.van_der_pol_like"
    source = damper_series_name(MASSES[1], SOURCE_DRAG)
    return [
        Entry("damper.rest_height", "equilibrium height of the damper",
              make_mean_measure(damper_series_name(MASSES[1]), "rest_height_D"), "D", MADE,
              note="The thesis does not print the piston's mass; 6.24 kg were chosen."),
        Entry("damper.nudge", "lift after the rest", make_mean_measure(source, "nudge_D"), "D", MADE),
        Entry(f"{law}.alpha", "alpha of the Van der Pol-like law, 1 kg/s", make_mean_measure(source, "alpha"),
              "", OWN_TERMS, note=SCALED_BY_EYE),
        Entry(f"{law}.omega", "omega of the same", make_mean_measure(source, "omega"), "", OWN_TERMS,
              covers=(f"{law}.z0", f"{law}.v0"), note=UNIT),
        Entry(f"{law}.g0", "g0 of the same", make_mean_measure(source, "g0"), "", OWN_TERMS,
              note=SCALED_BY_EYE),
        Entry("damper_implied.alpha_over_omega", "alpha/omega of the same, dimensionless",
              make_mean_measure(source, "alpha_over_omega"), "", MADE, digits=3),
        Entry("damper_implied.g0_over_omega2", "g0/omega² of the same",
              make_mean_measure(source, "g0_over_omega2"), digits=3,
              note="It is the equilibrium height in de Paula's scaling; the fit deviates from it because "
                   "the law does not follow the oscillation."),
        Entry("damper_implied.damping_ratio_at_rest", "damping ratio of the law at rest, 1 kg/s",
              make_mean_measure(source, "ratio_of_source_law"), "", MADE, digits=3,
              note="gamma, which is not printed, was chosen to give alpha/omega."),
        Entry("oscillator.decay", "decay found in the demonstration's motion",
              make_calculation_measure("oscillator", "decay"), "", MADE, digits=4,
              covers=("damper.damped_oscillator_demo",)),
        Entry("oscillator.frequency", "frequency found in it",
              make_calculation_measure("oscillator", "frequency"), "", MADE),
        Entry("experiment.greatest_force_N", "experiment: maximum force of the compression",
              make_mean_measure("pressed, R = 0.5", "force"), "N", OWN_TERMS, digits=0,
              note="Mixtures pressed to this force are under Experiment."),
    ]  # fmt: skip
