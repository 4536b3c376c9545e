"""What the source says without a number, tested on the runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from validation.published.measures import together
from validation.published.plan import (
    ASPECTS,
    GAMMAS,
    MASSES,
    RATIOS,
    SIZES,
    SOURCE_DRAG,
    SPEEDS,
    VARIANT_RATIOS,
    VARIANTS,
    damper_name,
    mixture_name,
)
from validation.published.protocols import QUICK
from validation.published.results import Results
from validation.published.values import published_value

FULL_PACKING = 0.2409
"""Packing fraction of equal grains at full compression: 368 (pi/4)/(60 20)."""
ALIKE = 0.2
"""Correlation of neighbours' forces up to which they are called independent."""
LEVEL = 0.05
"""Of tests."""


class StatementCheck(NamedTuple):
    """Whether a statement holds, and the figures that say so."""

    holds: bool
    figures: str


class Statement(NamedTuple):
    """A statement of the source.

    Attributes
    ----------
    source : str
    words : str
    test : callable
        None where its runs are not there.
    """

    source: str
    words: str
    test: Callable[[Results], StatementCheck | None]


def statements() -> tuple[Statement, ...]:
    """All statements, in the order of the source."""
    return (
        Statement("3.1", "the force grows exponentially with the packing, down and up with "
                  "different rates (Fig. 3.1)", _exponential),
        Statement("3.1", "close to the piston the fully compressed bed is denser than half way "
                  "(Fig. 3.2)", _inversion),
        Statement("3.1", "a loose start gives another force than a standard one", _loose),
        Statement("3.3", "the force does not depend on the piston's speed, 8.33 to 128 mm/s",
                  _speeds),
        Statement("3.3", "nor does the course of the mean distance (Fig. 3.4b)", _speed_courses),
        Statement("3.3", "on the way up the force oscillates more at higher speeds", _rough_up),
        Statement("3.3", "on the way down it jumps more at lower ones", _rough_down),
        Statement("3.4", "torque of second order changes F/F_max no more than another start",
                  _second_order),
        Statement("3.4", "it makes the hysteresis of the mean distance slightly greater",
                  _second_order_hysteresis),
        Statement("3.4", "high friction (0.8) makes the hysteresis of the mean distance much "
                  "greater", _high_friction),
        Statement("3.4", "high friction changes the way up more than the way down (Fig. 3.5)",
                  _high_friction_ways),
        Statement("3.4, 4.3.1", "greater friction needs a greater force at the same packing",
                  _friction_force),
        Statement("3.5", "F/F_max is the same for all sizes from 0.75 of the stroke on (Fig. 3.9)",
                  _same_stroke),
        Statement("3.5", "and from a packing of 0.14 on (Fig. 3.10)", _same_packing),
        Statement("3.5", "the course of the force is smoother in larger beds", _smoother),
        Statement("3.5", "the hysteresis of the mean distance grows with the bed", _growing),
        Statement("3.6", "slabs as walls cannot carry the bed", _slabs),
        Statement("3.6", "infinite walls do not give the force of the experimental law",
                  _infinite_walls),
        Statement("4.3.1", "F/F_max over the packing is the same for every mixture (Fig. 4.7)",
                  _mixture_courses),
        Statement("4.3.1", "F_max grows with R", _grows_with_ratio),
        Statement("4.3.1", "F_max grows as a falls", _grows_as_aspect_falls),
        Statement("4.3.1", "F(R)/F(1) lies on the printed curves of Table 4.5", _on_curves),
        Statement("4.3.1", "at R = 0.5 the grain nearest to the piston is a small one", _nearest),
        Statement("4.3.2", "the share of hexagons falls with a", _hexagons_by_aspect),
        Statement("4.3.2", "pure beds are ordered, mixtures near R = 0.5 least", _least_order),
        Statement("4.3.2", "R = 0 and R = 1 are alike", _ends_alike),
        Statement("4.2.4", "g(r) is periodic: there is an order of long range", _long_range),
        Statement("4.3.3", "drag and weightlessness change the force little", _variant_forces),
        Statement("4.3.4", "two mixtures of a = 0.75, of 5 and of 8 mm, have the same F(R)/F(1)",
                  _two_mixtures),
        Statement("4.3.5", "small grains feel smaller forces than big ones", _grain_forces),
        Statement("4.3.5", "forces on grains have two modes at R = 0.5 (Fig. 4.22)", _two_modes),
        Statement("4.3.5", "and one at R = 0 and R = 1 (Fig. 4.21 for R = 0)", _one_mode),
        Statement("4.3.5", "half of the grains belong to either mode (Fig. 4.22)", _even_split),
        Statement("4.3.5", "resulting forces prefer no direction (Fig. 4.23)", _no_direction),
        Statement("4.3.5", "there are no chains of forces (Fig. 4.24)", _no_chains),
        Statement("4.3.1", "two starts under the source's friction differ by at most 0.2 N",
                  _source_pairs),
        Statement("5.2.1", "symbolic regression finds z(t) of a damped oscillator", _symbolic),
        Statement("5.3.1", "the Van der Pol-like law follows the swing better than the linear one",
                  _van_der_pol),
        Statement("5.3.1", "at a drag of the grains that the source prints (0.1 kg/s)",
                  _van_der_pol_printed),
        Statement("4.3.2, experiment", "scattered moments make R near 1 less ordered", _scattered),
    )  # fmt: skip


def counted_statements(results: Results) -> dict[str, int]:
    """How many statements hold, do not hold, and were not run."""
    found = [one.test(results) for one in statements()]
    return {
        "hold": sum(one is not None and one.holds for one in found),
        "do not hold": sum(one is not None and not one.holds for one in found),
        "not run": sum(one is None for one in found),
    }


def _packings(count: int, course: np.ndarray, stretch: float = 1.0) -> np.ndarray:
    """Packing at even steps of the stroke, from the start's height to the end's."""
    size = (count / 368.0) ** 0.5
    start = max(75.0 * size, 50.0)
    heights = np.linspace(start, 20.0 * size, len(course))
    return np.asarray(FULL_PACKING * stretch * 20.0 * size / heights)


def _mean_course(results: Results, name: str, way: str) -> np.ndarray | None:
    courses = np.array(results.lists(name, way))
    return courses.mean(axis=0) if courses.ndim == 2 else None


def _exponential(results: Results) -> StatementCheck | None:
    courses = [_mean_course(results, "direct 368", way) for way in ("down", "up")]
    if courses[0] is None or courses[1] is None:
        return None
    rates, shares = [], []
    for course in (courses[0], courses[1][::-1]):
        packing = _packings(368, course)
        chosen = (packing > 0.12) & (course > 0.0)
        x, y = packing[chosen], np.log(course[chosen])
        rates.append(float(np.polyfit(x, y, 1)[0]))
        shares.append(float(np.corrcoef(x, y)[0, 1] ** 2))
    return StatementCheck(
        min(shares) > 0.95 and abs(rates[1] / rates[0] - 1.0) > 0.1,
        f"above a packing of 0.12 the logarithm has the slopes {rates[0]:.0f} and {rates[1]:.0f}, "
        f"R² {shares[0]:.3f} and {shares[1]:.3f}",
    )


def _inversion(results: Results) -> StatementCheck | None:
    profiles = np.array(results.lists("direct 368", "profile_full"))
    if profiles.ndim != 2:
        return None
    mean = profiles.mean(axis=0)
    upper, middle = float(mean[6:9].max()), float(mean[4:6].mean())
    return StatementCheck(
        upper > middle, f"local area fraction {upper:.3f} below the piston, {middle:.3f} half way"
    )


def _loose(results: Results) -> StatementCheck | None:
    found = together(["direct 368", "direct 368, loose start"], "force", results, QUICK.name)
    if found is None:
        return None
    one, other = (each.finding() for each in found)
    differs = abs(one.value - other.value) > 2.0 * max(one.spread or 0.0, other.spread or 0.0)
    return StatementCheck(differs, f"{one.value:.2f} N standard, {other.value:.2f} N loose")


def _speeds(results: Results) -> StatementCheck | None:
    names = ["direct 368", *(f"speed {v:g}" for v in SPEEDS[2:])]
    found = together(names, "force", results)
    if found is None:
        return None
    means = [one.values.mean() for one in found]
    worst = max(abs(one / means[0] - 1.0) for one in means)
    speeds = [SPEEDS[1], *SPEEDS[2:]]
    listed = ", ".join(f"{m:.2f} N at {v:g}" for v, m in zip(speeds, means, strict=True))
    return StatementCheck(bool(worst <= 0.03), f"{listed} mm/s")


def _speed_courses(results: Results) -> StatementCheck | None:
    names = ["direct 368", *(f"speed {v:g}" for v in SPEEDS[2:])]
    courses = [_mean_course(results, name, "half_course_D") for name in names]
    known = [one for one in courses if one is not None]
    if len(known) < len(courses):
        return None
    worst = max(float(np.abs(one - known[0]).max()) for one in known[1:])
    return StatementCheck(
        worst <= 0.5, f"the courses lie at most {worst:.2f} D from that at 8.33 mm/s"
    )


def _roughness(results: Results, way: str) -> tuple[list[float], str] | None:
    names = ["direct 368", *(f"speed {v:g}" for v in SPEEDS[2:])]
    found = together(names, f"roughness_{way}", results)
    if found is None:
        return None
    values = [float(one.values.mean()) for one in found]
    speeds = [SPEEDS[1], *SPEEDS[2:]]
    listed = ", ".join(f"{v:.4f} at {s:g}" for s, v in zip(speeds, values, strict=True))
    return values, f"rms of what is rough, over F_max: {listed} mm/s"


def _rough_up(results: Results) -> StatementCheck | None:
    found = _roughness(results, "up")
    return None if found is None else StatementCheck(found[0][-1] > found[0][0], found[1])


def _rough_down(results: Results) -> StatementCheck | None:
    found = _roughness(results, "down")
    return None if found is None else StatementCheck(found[0][-1] < found[0][0], found[1])


def _same_stroke(results: Results) -> StatementCheck | None:
    courses = _sizes(results)
    if courses is None:
        return None
    late = np.array([one[int(0.75 * (len(one) - 1)) :] / one[-1] for one in courses])
    worst = float(np.ptp(late, axis=0).max())
    return StatementCheck(worst <= 0.05, f"there the sizes differ by at most {worst:.3f}")


def _same_packing(results: Results) -> StatementCheck | None:
    courses = _sizes(results)
    if courses is None:
        return None
    grid = np.linspace(0.14, 0.24, 41)
    rows = [
        np.interp(grid, _packings(n, one), one / one[-1])
        for n, one in zip(SIZES, courses, strict=True)
    ]
    worst = float(np.ptp(rows, axis=0).max())
    return StatementCheck(worst <= 0.05, f"there the sizes differ by at most {worst:.3f}")


def _sizes(results: Results) -> list[np.ndarray] | None:
    courses = [_mean_course(results, f"direct {n}", "down") for n in SIZES]
    known = [one for one in courses if one is not None]
    return known if len(known) == len(courses) else None


def _smoother(results: Results) -> StatementCheck | None:
    found = together([f"direct {n}" for n in SIZES], "roughness_down", results)
    if found is None:
        return None
    values = [float(one.values.mean()) for one in found]
    listed = ", ".join(f"{v:.4f} (N = {n})" for n, v in zip(SIZES, values, strict=True))
    return StatementCheck(values[-1] < values[0], f"rms of what is rough, over F_max: {listed}")


def _growing(results: Results) -> StatementCheck | None:
    found = together([f"direct {n}" for n in SIZES], "hysteresis_D", results)
    if found is None:
        return None
    values = [float(one.values.mean()) for one in found]
    listed = ", ".join(f"{v:.2f}" for v in values)
    return StatementCheck(values[-1] > values[0], f"{listed} D for N = 92 to 736")


def _slabs(results: Results) -> StatementCheck | None:
    found = together(["slabs", "slabs"], "lowest_start_D", results)
    loads = together(["slabs", "slabs"], "bottom_start", results)
    weights = together(["slabs", "slabs"], "weight", results)
    if found is None or loads is None or weights is None:
        return None
    lowest, load = float(found[0].values.min()), float(loads[0].values.mean())
    weight = float(weights[0].values.mean())
    return StatementCheck(
        not (lowest > 0.0 and load > 0.0),
        f"here they do: the lowest grain stands {lowest:.2f} D above the bottom, which bears "
        f"{load:.2f} N before the compression (weight {weight:.2f} N)",
    )


def _infinite_walls(results: Results) -> StatementCheck | None:
    found = together(["direct 368", "infinite walls", "slabs"], "force", results, QUICK.name)
    if found is None:
        return None
    usual, infinite, slabs = (one.finding() for one in found)
    differs = abs(infinite.value - usual.value) > 3.0 * (usual.spread or 0.0)
    return StatementCheck(
        differs,
        f"{usual.value:.2f} N with the experimental law, {infinite.value:.2f} N with infinite "
        f"walls, {slabs.value:.2f} N with slabs",
    )


def _mixture_courses(results: Results) -> StatementCheck | None:
    courses = [_mean_course(results, mixture_name(a, 0.5), "down") for a in ASPECTS]
    known = [one / one[-1] for one in courses if one is not None]
    if len(known) < len(courses):
        return None
    grid = np.linspace(0.1, 0.34, 49)
    rows = []
    for aspect, course in zip(ASPECTS, known, strict=True):
        end = 14.0 * (1.0 + 0.5 * (aspect**2 - 1.0))
        packing = 0.34 * end / np.linspace(89.0, end, len(course))
        rows.append(np.interp(grid, packing, course))
    worst = float(np.ptp(rows, axis=0).max())
    return StatementCheck(worst <= 0.05, f"at R = 0.5 they differ by at most {worst:.3f}")


def _on_curves(results: Results) -> StatementCheck | None:
    words, holds = [], []
    for place, (label, big) in enumerate(
        (("0.75", 0.005), ("0.6", 0.005), ("0.5", 0.005), ("0.75", 0.008))
    ):
        names = [mixture_name(float(label), r, big) for r in RATIOS]
        found = together(names, "force", results)
        if found is None:
            return None
        last = found[-1].values.mean()
        a, slow, b, fast = (
            float(published_value(f"biexponential_fmax.{name}[{place}]"))
            for name in ("A", "lambda1", "B", "lambda2")
        )
        x = np.array(RATIOS)
        curve = a * np.exp(slow * x) + b * np.exp(fast * x)
        off = np.array([one.values.mean() for one in found]) / last - curve
        worst = float(np.abs(off).max())
        holds.append(worst <= 0.02)
        words.append(f"{worst:.3f} (a = {label}{', 6:8 mm' if big != 0.005 else ''})")
    return StatementCheck(all(holds), f"greatest distance from the curve: {', '.join(words)}")


def _ends_alike(results: Results) -> StatementCheck | None:
    found = together([mixture_name(0.6, 0.0), mixture_name(0.6, 1.0)], "hexagons_full", results)
    if found is None:
        return None
    one, other = (float(each.values.mean()) for each in found)
    return StatementCheck(
        abs(one - other) <= 0.05, f"share of hexagons {one:.3f} at R = 0, {other:.3f} at R = 1"
    )


def _long_range(results: Results) -> StatementCheck | None:
    found = together(["direct 368", mixture_name(0.6, 0.0)], "shells", results)
    if found is None:
        return None
    values = [float(one.values.mean()) for one in found]
    return StatementCheck(
        min(values) >= 4.0,
        f"{values[0]:.1f} shells in equal beds of 368, {values[1]:.1f} at R = 0 of the mixtures",
    )


def _two_modes(results: Results) -> StatementCheck | None:
    found = together([mixture_name(a, 0.5) for a in ASPECTS], "dip_p", results)
    if found is None:
        return None
    worst = [float(one.values.max()) for one in found]
    return StatementCheck(max(worst) < LEVEL, f"dip test, greatest p: {_listed(worst, '.4f')}")


def _one_mode(results: Results) -> StatementCheck | None:
    names = [mixture_name(0.6, 0.0), *(mixture_name(a, 1.0) for a in ASPECTS)]
    found = together(names, "dip_p", results)
    if found is None:
        return None
    least = [float(one.values.min()) for one in found]
    words = ", ".join(f"{p:.2f}" for p in least)
    # Of so many tests at once, by Bonferroni.
    return StatementCheck(
        min(least) > LEVEL / sum(len(one.values) for one in found),
        f"dip test, least p: {words} (R = 0; R = 1 of a = 0.75, 0.6, 0.5)",
    )


def _even_split(results: Results) -> StatementCheck | None:
    shares = _halves(results, "small_below_median")
    if shares is None:
        return None
    return StatementCheck(
        min(shares) > 0.95, f"small grains below the median of all: {_listed(shares, '.2f')}"
    )


def _no_direction(results: Results) -> StatementCheck | None:
    names = [mixture_name(0.6, r) for r in (0.25, 0.5, 0.75)]
    found = together(names, "axial_p", results)
    orders = together(names, "axial_order", results)
    if found is None or orders is None:
        return None
    p = np.concatenate([one.values for one in found])
    greatest = max(float(one.values.max()) for one in orders)
    return StatementCheck(
        bool(p.min() > LEVEL / len(p)),
        f"Rayleigh's test of the axes, least p of {len(p)} beds: {p.min():.3f}; greatest order "
        f"{greatest:.2f} of 1",
    )


def _no_chains(results: Results) -> StatementCheck | None:
    names = [mixture_name(0.6, r) for r in (0.25, 0.5, 0.75)]
    found = together(names, "neighbours_alike", results)
    if found is None:
        return None
    values = [float(one.values.mean()) for one in found]
    listed = ", ".join(f"{v:.2f}" for v in values)
    return StatementCheck(
        max(abs(one) for one in values) < ALIKE,
        f"correlation of neighbours' compressive forces, over the mean of the species: {listed} "
        "(R = 0.25, 0.5, 0.75)",
    )


def _source_pairs(results: Results) -> StatementCheck | None:
    names = [f"source's friction, {mixture_name(a, 0.5)}" for a in ASPECTS]
    found = together(names, "force", results)
    if found is None:
        return None
    gaps = [float(np.ptp(one.values[:2])) for one in found]
    return StatementCheck(max(gaps) <= 0.2, f"they differ by {_listed(gaps, '.2f', ' N')}")


def _symbolic(results: Results) -> StatementCheck | None:
    misfit, length = (results.number("symbolic", name) for name in ("misfit", "length"))
    if misfit is None or length is None:
        return None
    return StatementCheck(
        misfit < 1e-3,
        f"pyoperon finds an expression of {length:.0f} symbols that leaves {misfit:.1e} of the "
        "motion; of PySR, which needs Julia, the source prints no settings",
    )


def _misfits(results: Results, drag: float) -> tuple[float, float] | None:
    name = damper_name(MASSES[1], drag)
    found = [results.sample(name, one) for one in ("free_misfit", "free_linear_misfit")]
    if found[0] is None or found[1] is None:
        return None
    return float(found[0].values.mean()), float(found[1].values.mean())


def _van_der_pol(results: Results) -> StatementCheck | None:
    rows = [(drag, _misfits(results, drag)) for drag in GAMMAS]
    at_source = _misfits(results, SOURCE_DRAG)
    if at_source is None:
        return None
    listed = ", ".join(
        f"{100.0 * one[0]:.1f} and {100.0 * one[1]:.1f} % at {drag:g}"
        for drag, one in rows if one is not None
    )  # fmt: skip
    return StatementCheck(
        at_source[0] < 0.5 * at_source[1],
        f"what both leave over of the swing: {listed} kg/s",
    )


def _van_der_pol_printed(results: Results) -> StatementCheck | None:
    found = _misfits(results, GAMMAS[0])
    if found is None:
        return None
    return StatementCheck(
        found[0] < 0.5 * found[1],
        f"{100.0 * found[0]:.2f} and {100.0 * found[1]:.2f} % of the swing are left over",
    )


def _scattered(results: Results) -> StatementCheck | None:
    names = ["pressed, R = 1", "pressed, R = 1, moments ± 0.1", "pressed, R = 0",
             "pressed, R = 0, moments ± 0.1"]  # fmt: skip
    found = together(names, "hexagons_pressed", results)
    if found is None:
        return None
    even, uneven, zero, zero_uneven = (float(one.values.mean()) for one in found)
    return StatementCheck(
        uneven < even - 0.05,
        f"at 110 N the share of hexagons at R = 1 is {even:.2f} with equal moments, {uneven:.2f} "
        f"with a scatter of 10 % (R = 0: {zero:.2f} and {zero_uneven:.2f})",
    )


def _pair(results: Results, figure: str, first: str, second: str) -> tuple[float, float] | None:
    found = together([first, second], figure, results)
    return None if found is None else (found[0].values.mean(), found[1].values.mean())


def _second_order(results: Results) -> StatementCheck | None:
    """The source compares forces over their greatest."""
    pair = _pair(results, "force", "starts", "second order")
    usual, second = (_course(results, name) for name in ("starts", "second order"))
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


def _course(results: Results, name: str) -> np.ndarray | None:
    """Force over the mean greatest one, down and up, of every start."""
    courses = [np.array(results.lists(name, way)) for way in ("down", "up")]
    if any(one.ndim != 2 for one in courses):
        return None
    course = np.concatenate(courses, axis=1)
    return np.asarray(course / course.max(axis=1).mean())


def _second_order_hysteresis(results: Results) -> StatementCheck | None:
    pair = _pair(results, "hysteresis_D", "starts", "second order")
    if pair is None:
        return None
    return StatementCheck(
        pair[0] < pair[1] < 1.2 * pair[0], f"{pair[0]:.2f} D to first, {pair[1]:.2f} D to second"
    )


def _high_friction(results: Results) -> StatementCheck | None:
    pair = _pair(results, "hysteresis_D", "starts", "second order, 0.8")
    if pair is None:
        return None
    return StatementCheck(
        pair[1] > 1.2 * pair[0], f"{pair[0]:.2f} D with 0.6 and 0.45, {pair[1]:.2f} D with 0.8"
    )


def _high_friction_ways(results: Results) -> StatementCheck | None:
    usual, high = (_course(results, name) for name in ("starts", "second order, 0.8"))
    if usual is None or high is None:
        return None
    gap = np.abs(high.mean(axis=0) - usual.mean(axis=0))
    down, up = float(gap[: len(gap) // 2].max()), float(gap[len(gap) // 2 :].max())
    return StatementCheck(up > down, f"F/F_max differs by {down:.3f} down and {up:.3f} up")


def _friction_force(results: Results) -> StatementCheck | None:
    names = ["drag", "starts", "second order, 0.8"]
    found = together(names, "force", results)
    if found is None:
        return None
    means = [float(one.values.mean()) for one in found]
    words = "without friction (drag), usual, 0.8: " + ", ".join(f"{one:.2f} N" for one in means)
    return StatementCheck(means == sorted(means), words)


def _scan(results: Results, aspect: float, figure: str, big: float = 0.005) -> np.ndarray | None:
    found = together([mixture_name(aspect, r, big) for r in RATIOS], figure, results)
    return None if found is None else np.array([one.values.mean() for one in found])


def _grows_with_ratio(results: Results) -> StatementCheck | None:
    scans = [_scan(results, a, "force") for a in ASPECTS]
    if any(one is None for one in scans):
        return None
    known = [one for one in scans if one is not None]
    words = "; ".join(
        f"a = {a:g}: {one[0]:.1f} to {one[-1]:.1f} N" for a, one in zip(ASPECTS, known, strict=True)
    )
    return StatementCheck(
        all(bool((np.diff(one) > -0.01 * one[:-1]).all()) for one in known), words
    )


def _halves(results: Results, figure: str) -> list[float] | None:
    found = together([mixture_name(a, 0.5) for a in ASPECTS], figure, results)
    return None if found is None else [float(one.values.mean()) for one in found]


def _listed(values: Sequence[float], form: str, unit: str = "") -> str:
    pairs = zip(ASPECTS, values, strict=True)
    return ", ".join(f"{value:{form}}{unit} (a = {a:g})" for a, value in pairs)


def _grows_as_aspect_falls(results: Results) -> StatementCheck | None:
    forces = _halves(results, "force")
    if forces is None:
        return None
    return StatementCheck(forces == sorted(forces), _listed(forces, ".1f", " N"))


def _nearest(results: Results) -> StatementCheck | None:
    shares = _halves(results, "nearest_species")
    if shares is None:
        return None
    return StatementCheck(min(shares) > 0.5, f"share of starts: {_listed(shares, '.2f')}")


def _hexagons_by_aspect(results: Results) -> StatementCheck | None:
    shares = _halves(results, "hexagons_full")
    if shares is None:
        return None
    return StatementCheck(shares == sorted(shares, reverse=True), _listed(shares, ".2f"))


def _least_order(results: Results) -> StatementCheck | None:
    scans = [_scan(results, a, "hexagons_full") for a in ASPECTS]
    if any(one is None for one in scans):
        return None
    least = [RATIOS[int(one.argmin())] for one in scans if one is not None]
    return StatementCheck(
        all(0.3 <= one <= 0.7 for one in least), f"least at R = {_listed(least, 'g')}"
    )


def _variant_forces(results: Results) -> StatementCheck | None:
    usual = [mixture_name(0.6, r) for r in VARIANT_RATIOS]
    others = [[f"{name}, R = {r:g}" for r in VARIANT_RATIOS] for name in VARIANTS]
    found = together([*usual, *(one for some in others for one in some)], "force", results)
    if found is None:
        return None
    means = np.array([one.values.mean() for one in found]).reshape(1 + len(VARIANTS), -1)
    normal = means / means[:, -1:]
    worst = np.abs(normal[1:] - normal[0]).max(axis=1)
    words = ", ".join(f"{w:.3f} ({name})" for name, w in zip(VARIANTS, worst, strict=True))
    return StatementCheck(bool(worst.max() <= 0.05), f"greatest difference of F(R)/F(1): {words}")


def _two_mixtures(results: Results) -> StatementCheck | None:
    scans = [_scan(results, 0.75, "force", big) for big in (0.005, 0.008)]
    if scans[0] is None or scans[1] is None:
        return None
    worst = float(np.abs(scans[0] / scans[0][-1] - scans[1] / scans[1][-1]).max())
    return StatementCheck(worst <= 0.05, f"greatest difference {worst:.3f}")


def _grain_forces(results: Results) -> StatementCheck | None:
    big, small = _halves(results, "big_compression"), _halves(results, "small_compression")
    if big is None or small is None:
        return None
    ratios = [s / b for s, b in zip(small, big, strict=True)]
    return StatementCheck(
        max(ratios) < 1.0, f"compressive force, small over big: {_listed(ratios, '.2f')}"
    )
