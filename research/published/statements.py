"""Qualitative statements of de Paula, tested on the runs."""

from __future__ import annotations

from research.published import bed_statements as bed
from research.published import damper_statements as damper
from research.published import mixture_statements as mixture
from research.published.results import Results
from research.published.statement import Statement


def statements() -> tuple[Statement, ...]:
    """Return all statements, in the order of the thesis."""
    return (
        Statement(
            "3.1",
            "the force grows exponentially with the packing, down and up with different rates (Fig. 3.1)",
            bed.exponential,
        ),
        Statement(
            "3.1",
            "close to the piston the fully compressed bed is denser than at half height (Fig. 3.2)",
            bed.inversion,
        ),
        Statement("3.1", "a loose start gives another force than a standard one", bed.loose),
        Statement("3.3", "the force does not depend on the piston's speed, 8.33 to 128 mm/s", bed.speeds),
        Statement("3.3", "nor does the curve of the mean distance (Fig. 3.4b)", bed.speed_courses),
        Statement("3.3", "on the way up the force oscillates more at higher speeds", bed.rough_up),
        Statement("3.3", "on the way down it jumps more at lower ones", bed.rough_down),
        Statement(
            "3.4", "torque of second order changes F/F_max no more than another start", bed.second_order
        ),
        Statement(
            "3.4", "it slightly increases the hysteresis of the mean distance", bed.second_order_hysteresis
        ),
        Statement(
            "3.4",
            "high friction (0.8) strongly increases the hysteresis of the mean distance",
            bed.high_friction,
        ),
        Statement(
            "3.4",
            "high friction changes the way up more than the way down (Fig. 3.5)",
            bed.high_friction_ways,
        ),
        Statement(
            "3.4, 4.3.1", "higher friction needs a larger force at the same packing", bed.friction_force
        ),
        Statement(
            "3.5", "F/F_max is the same for all sizes from 0.75 of the stroke on (Fig. 3.9)", bed.same_stroke
        ),
        Statement("3.5", "and from a packing of 0.14 on (Fig. 3.10)", bed.same_packing),
        Statement("3.5", "the force curve is smoother in larger beds", bed.smoother),
        Statement("3.5", "the hysteresis of the mean distance grows with the bed", bed.growing),
        Statement("3.6", "slabs as walls cannot carry the bed", bed.slabs),
        Statement("3.6", "infinite walls do not give the force of the experimental law", bed.infinite_walls),
        Statement(
            "4.3.1",
            "F/F_max over the packing is the same for every mixture (Fig. 4.7)",
            mixture.mixture_courses,
        ),
        Statement("4.3.1", "F_max grows with R", mixture.grows_with_ratio),
        Statement("4.3.1", "F_max grows as a falls", mixture.grows_as_aspect_falls),
        Statement("4.3.1", "F(R)/F(1) lies on the printed curves of Table 4.5", mixture.on_curves),
        Statement("4.3.1", "at R = 0.5 the grain nearest to the piston is a small one", mixture.nearest),
        Statement("4.3.2", "the fraction of hexagons falls with a", mixture.hexagons_by_aspect),
        Statement(
            "4.3.2",
            "pure beds are ordered, mixtures near R = 0.5 have the lowest order",
            mixture.order_minimum,
        ),
        Statement("4.3.2", "R = 0 and R = 1 are similar", mixture.pure_beds_are_similar),
        Statement("4.2.4", "g(r) is periodic: there is long-range order", mixture.long_range),
        Statement("4.3.3", "drag and weightlessness change the force little", mixture.variant_forces),
        Statement(
            "4.3.4",
            "two mixtures of a = 0.75, of 5 and of 8 mm, have the same F(R)/F(1)",
            mixture.two_mixtures,
        ),
        Statement("4.3.5", "small grains feel smaller forces than big ones", mixture.grain_forces),
        Statement("4.3.5", "forces on grains have two modes at R = 0.5 (Fig. 4.22)", mixture.two_modes),
        Statement("4.3.5", "and one at R = 0 and R = 1 (Fig. 4.21 for R = 0)", mixture.one_mode),
        Statement("4.3.5", "half of the grains belong to either mode (Fig. 4.22)", mixture.even_split),
        Statement("4.3.5", "resulting forces prefer no direction (Fig. 4.23)", mixture.no_direction),
        Statement("4.3.5", "there are no chains of forces (Fig. 4.24)", mixture.no_chains),
        Statement(
            "4.3.1", "two starts under de Paula's friction differ by at most 0.2 N", mixture.source_pairs
        ),
        Statement("5.2.1", "symbolic regression finds z(t) of a damped oscillator", damper.symbolic),
        Statement(
            "5.3.1",
            "the Van der Pol-like law follows the oscillation better than the linear one",
            damper.van_der_pol,
        ),
        Statement(
            "5.3.1", "at a drag of the grains that de Paula prints (0.1 kg/s)", damper.van_der_pol_printed
        ),
        Statement("4.3.2, experiment", "scattered moments make R near 1 less ordered", damper.scattered),
    )


def counted_statements(results: Results) -> dict[str, int]:
    """Return the numbers of statements that hold, do not hold, and were not run."""
    result = [item.check(results) for item in statements()]
    return {
        "hold": sum(item is not None and item.holds for item in result),
        "do not hold": sum(item is not None and not item.holds for item in result),
        "not run": sum(item is None for item in result),
    }
