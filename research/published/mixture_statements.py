"""Tests of de Paula's qualitative statements on mixtures [D, chapter 4]."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from research.published.measures import samples_under_common_protocol
from research.published.plan import ASPECTS, RATIOS, VARIANT_RATIOS, VARIANTS, mixture_series_name
from research.published.results import PublishedResults
from research.published.statement import LEVEL, StatementCheck, mean_curve_over_starts
from validation.measured_quantities import published_value

ALIKE = 0.2
"""Maximum correlation of neighbours' forces that counts as independent."""


def mean_figure_by_big_grain_fraction(
    results: PublishedResults, aspect: float, figure: str, big: float = 0.005
) -> np.ndarray | None:
    result = samples_under_common_protocol(
        [mixture_series_name(aspect, r, big) for r in RATIOS], figure, results
    )
    return None if result is None else np.array([item.values.mean() for item in result])


def mean_figure_by_aspect_ratio_in_half_mixtures(
    results: PublishedResults, figure: str
) -> list[float] | None:
    result = samples_under_common_protocol([mixture_series_name(a, 0.5) for a in ASPECTS], figure, results)
    return None if result is None else [float(item.values.mean()) for item in result]


def values_by_aspect_ratio_text(values: Sequence[float], form: str, unit: str = "") -> str:
    pairs = zip(ASPECTS, values, strict=True)
    return ", ".join(f"{value:{form}}{unit} (a = {a:g})" for a, value in pairs)


def check_mixtures_share_force_curve_over_packing(results: PublishedResults) -> StatementCheck | None:
    courses = [mean_curve_over_starts(results, mixture_series_name(a, 0.5), "down") for a in ASPECTS]
    known = [item / item[-1] for item in courses if item is not None]
    if len(known) < len(courses):
        return None
    grid = np.linspace(0.1, 0.34, 49)
    rows = []
    for aspect, trajectory in zip(ASPECTS, known, strict=True):
        end = 14.0 * (1.0 + 0.5 * (aspect**2 - 1.0))
        packing = 0.34 * end / np.linspace(89.0, end, len(trajectory))
        rows.append(np.interp(grid, packing, trajectory))
    worst = float(np.ptp(rows, axis=0).max())
    return StatementCheck(worst <= 0.05, f"at R = 0.5 they differ by at most {worst:.3f}")


def check_forces_lie_on_published_curves(results: PublishedResults) -> StatementCheck | None:
    words, holds = [], []
    for index, (label, big) in enumerate((("0.75", 0.005), ("0.6", 0.005), ("0.5", 0.005), ("0.75", 0.008))):
        names = [mixture_series_name(float(label), r, big) for r in RATIOS]
        result = samples_under_common_protocol(names, "force", results)
        if result is None:
            return None
        last = result[-1].values.mean()
        a, slow, b, fast = (
            float(published_value(f"biexponential_fmax.{name}[{index}]"))
            for name in ("A", "lambda1", "B", "lambda2")
        )
        x = np.array(RATIOS)
        curve = a * np.exp(slow * x) + b * np.exp(fast * x)
        off = np.array([item.values.mean() for item in result]) / last - curve
        worst = float(np.abs(off).max())
        holds.append(worst <= 0.02)
        words.append(f"{worst:.3f} (a = {label}{', 6:8 mm' if big != 0.005 else ''})")
    return StatementCheck(all(holds), f"maximum distance from the curve: {', '.join(words)}")


def check_pure_beds_have_similar_hexagon_fractions(results: PublishedResults) -> StatementCheck | None:
    result = samples_under_common_protocol(
        [mixture_series_name(0.6, 0.0), mixture_series_name(0.6, 1.0)], "hexagons_full", results
    )
    if result is None:
        return None
    item, other = (float(entry.values.mean()) for entry in result)
    return StatementCheck(
        abs(item - other) <= 0.05, f"fraction of hexagons {item:.3f} at R = 0, {other:.3f} at R = 1"
    )


def check_pure_beds_have_long_range_order(results: PublishedResults) -> StatementCheck | None:
    result = samples_under_common_protocol(["direct 368", mixture_series_name(0.6, 0.0)], "shells", results)
    if result is None:
        return None
    values = [float(item.values.mean()) for item in result]
    return StatementCheck(
        min(values) >= 4.0,
        f"{values[0]:.1f} shells in equal beds of 368, {values[1]:.1f} at R = 0 of the mixtures",
    )


def check_grain_forces_of_half_mixtures_have_two_modes(results: PublishedResults) -> StatementCheck | None:
    result = samples_under_common_protocol([mixture_series_name(a, 0.5) for a in ASPECTS], "dip_p", results)
    if result is None:
        return None
    worst = [float(item.values.max()) for item in result]
    return StatementCheck(
        max(worst) < LEVEL, f"dip test, maximum p: {values_by_aspect_ratio_text(worst, '.4f')}"
    )


def check_grain_forces_of_pure_beds_have_one_mode(results: PublishedResults) -> StatementCheck | None:
    names = [mixture_series_name(0.6, 0.0), *(mixture_series_name(a, 1.0) for a in ASPECTS)]
    result = samples_under_common_protocol(names, "dip_p", results)
    if result is None:
        return None
    minima = [float(item.values.min()) for item in result]
    words = ", ".join(f"{p:.2f}" for p in minima)
    # Several simultaneous tests: Bonferroni correction.
    return StatementCheck(
        min(minima) > LEVEL / sum(len(item.values) for item in result),
        f"dip test, minimum p: {words} (R = 0; R = 1 of a = 0.75, 0.6, 0.5)",
    )


def check_small_grains_form_lower_force_mode(results: PublishedResults) -> StatementCheck | None:
    fractions = mean_figure_by_aspect_ratio_in_half_mixtures(results, "small_below_median")
    if fractions is None:
        return None
    return StatementCheck(
        min(fractions) > 0.95,
        f"small grains below the median of all: {values_by_aspect_ratio_text(fractions, '.2f')}",
    )


def check_forces_prefer_no_direction(results: PublishedResults) -> StatementCheck | None:
    names = [mixture_series_name(0.6, r) for r in (0.25, 0.5, 0.75)]
    result = samples_under_common_protocol(names, "axial_p", results)
    orders = samples_under_common_protocol(names, "axial_order", results)
    if result is None or orders is None:
        return None
    p = np.concatenate([item.values for item in result])
    maximum_order = max(float(item.values.max()) for item in orders)
    return StatementCheck(
        bool(p.min() > LEVEL / len(p)),
        f"Rayleigh's test of the axes, minimum p of {len(p)} beds: {p.min():.3f}; maximum order "
        f"{maximum_order:.2f} of 1",
    )


def check_forces_form_no_chains(results: PublishedResults) -> StatementCheck | None:
    names = [mixture_series_name(0.6, r) for r in (0.25, 0.5, 0.75)]
    result = samples_under_common_protocol(names, "neighbours_alike", results)
    if result is None:
        return None
    values = [float(item.values.mean()) for item in result]
    listed = ", ".join(f"{v:.2f}" for v in values)
    return StatementCheck(
        max(abs(item) for item in values) < ALIKE,
        f"correlation of neighbours' compressive forces, over the mean of the species: {listed} "
        "(R = 0.25, 0.5, 0.75)",
    )


def check_two_starts_agree_under_source_friction(results: PublishedResults) -> StatementCheck | None:
    names = [f"source's friction, {mixture_series_name(a, 0.5)}" for a in ASPECTS]
    result = samples_under_common_protocol(names, "force", results)
    if result is None:
        return None
    gaps = [float(np.ptp(item.values[:2])) for item in result]
    return StatementCheck(
        max(gaps) <= 0.2, f"they differ by {values_by_aspect_ratio_text(gaps, '.2f', ' N')}"
    )


def check_force_grows_with_big_grain_fraction(results: PublishedResults) -> StatementCheck | None:
    scans = [mean_figure_by_big_grain_fraction(results, a, "force") for a in ASPECTS]
    if any(item is None for item in scans):
        return None
    known = [item for item in scans if item is not None]
    words = "; ".join(
        f"a = {a:g}: {item[0]:.1f} to {item[-1]:.1f} N" for a, item in zip(ASPECTS, known, strict=True)
    )
    return StatementCheck(all(bool((np.diff(item) > -0.01 * item[:-1]).all()) for item in known), words)


def check_force_grows_as_aspect_ratio_falls(results: PublishedResults) -> StatementCheck | None:
    forces = mean_figure_by_aspect_ratio_in_half_mixtures(results, "force")
    if forces is None:
        return None
    return StatementCheck(forces == sorted(forces), values_by_aspect_ratio_text(forces, ".1f", " N"))


def check_grain_nearest_to_piston_is_small(results: PublishedResults) -> StatementCheck | None:
    fractions = mean_figure_by_aspect_ratio_in_half_mixtures(results, "nearest_species")
    if fractions is None:
        return None
    return StatementCheck(
        min(fractions) > 0.5, f"fraction of starts: {values_by_aspect_ratio_text(fractions, '.2f')}"
    )


def check_hexagon_fraction_falls_with_aspect_ratio(results: PublishedResults) -> StatementCheck | None:
    fractions = mean_figure_by_aspect_ratio_in_half_mixtures(results, "hexagons_full")
    if fractions is None:
        return None
    return StatementCheck(
        fractions == sorted(fractions, reverse=True), values_by_aspect_ratio_text(fractions, ".2f")
    )


def check_order_is_lowest_in_half_mixtures(results: PublishedResults) -> StatementCheck | None:
    scans = [mean_figure_by_big_grain_fraction(results, a, "hexagons_full") for a in ASPECTS]
    if any(item is None for item in scans):
        return None
    minima = [RATIOS[int(item.argmin())] for item in scans if item is not None]
    return StatementCheck(
        all(0.3 <= item <= 0.7 for item in minima),
        f"minimum at R = {values_by_aspect_ratio_text(minima, 'g')}",
    )


def check_drag_and_weightlessness_barely_change_force(results: PublishedResults) -> StatementCheck | None:
    usual = [mixture_series_name(0.6, r) for r in VARIANT_RATIOS]
    others = [[f"{name}, R = {r:g}" for r in VARIANT_RATIOS] for name in VARIANTS]
    result = samples_under_common_protocol(
        [*usual, *(item for some in others for item in some)], "force", results
    )
    if result is None:
        return None
    means = np.array([item.values.mean() for item in result]).reshape(1 + len(VARIANTS), -1)
    normal = means / means[:, -1:]
    worst = np.abs(normal[1:] - normal[0]).max(axis=1)
    words = ", ".join(f"{w:.3f} ({name})" for name, w in zip(VARIANTS, worst, strict=True))
    return StatementCheck(bool(worst.max() <= 0.05), f"maximum difference of F(R)/F(1): {words}")


def check_grain_sizes_share_relative_force_curve(results: PublishedResults) -> StatementCheck | None:
    scans = [mean_figure_by_big_grain_fraction(results, 0.75, "force", big) for big in (0.005, 0.008)]
    if scans[0] is None or scans[1] is None:
        return None
    worst = float(np.abs(scans[0] / scans[0][-1] - scans[1] / scans[1][-1]).max())
    return StatementCheck(worst <= 0.05, f"maximum difference {worst:.3f}")


def check_small_grains_feel_smaller_forces(results: PublishedResults) -> StatementCheck | None:
    big, small = (
        mean_figure_by_aspect_ratio_in_half_mixtures(results, "big_compression"),
        mean_figure_by_aspect_ratio_in_half_mixtures(results, "small_compression"),
    )
    if big is None or small is None:
        return None
    ratios = [s / b for s, b in zip(small, big, strict=True)]
    return StatementCheck(
        max(ratios) < 1.0, f"compressive force, small over big: {values_by_aspect_ratio_text(ratios, '.2f')}"
    )
