"""Tests of what de Paula says without a number of mixtures [D, chapter 4]."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from research.published.measures import together
from research.published.plan import (
    ASPECTS,
    RATIOS,
    VARIANT_RATIOS,
    VARIANTS,
    mixture_name,
)
from research.published.results import Results
from research.published.statement import (
    LEVEL,
    StatementCheck,
    mean_course,
)
from validation.published import published_value

ALIKE = 0.2
"""Correlation of neighbours' forces up to which they are called independent."""


def scan(results: Results, aspect: float, figure: str, big: float = 0.005) -> np.ndarray | None:
    found = together([mixture_name(aspect, r, big) for r in RATIOS], figure, results)
    return None if found is None else np.array([one.values.mean() for one in found])


def halves(results: Results, figure: str) -> list[float] | None:
    found = together([mixture_name(a, 0.5) for a in ASPECTS], figure, results)
    return None if found is None else [float(one.values.mean()) for one in found]


def listed(values: Sequence[float], form: str, unit: str = "") -> str:
    pairs = zip(ASPECTS, values, strict=True)
    return ", ".join(f"{value:{form}}{unit} (a = {a:g})" for a, value in pairs)


def mixture_courses(results: Results) -> StatementCheck | None:
    courses = [mean_course(results, mixture_name(a, 0.5), "down") for a in ASPECTS]
    known = [one / one[-1] for one in courses if one is not None]
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


def on_curves(results: Results) -> StatementCheck | None:
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


def ends_alike(results: Results) -> StatementCheck | None:
    found = together([mixture_name(0.6, 0.0), mixture_name(0.6, 1.0)], "hexagons_full", results)
    if found is None:
        return None
    one, other = (float(each.values.mean()) for each in found)
    return StatementCheck(
        abs(one - other) <= 0.05, f"fraction of hexagons {one:.3f} at R = 0, {other:.3f} at R = 1"
    )


def long_range(results: Results) -> StatementCheck | None:
    found = together(["direct 368", mixture_name(0.6, 0.0)], "shells", results)
    if found is None:
        return None
    values = [float(one.values.mean()) for one in found]
    return StatementCheck(
        min(values) >= 4.0,
        f"{values[0]:.1f} shells in equal beds of 368, {values[1]:.1f} at R = 0 of the mixtures",
    )


def two_modes(results: Results) -> StatementCheck | None:
    found = together([mixture_name(a, 0.5) for a in ASPECTS], "dip_p", results)
    if found is None:
        return None
    worst = [float(one.values.max()) for one in found]
    return StatementCheck(max(worst) < LEVEL, f"dip test, greatest p: {listed(worst, '.4f')}")


def one_mode(results: Results) -> StatementCheck | None:
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


def even_split(results: Results) -> StatementCheck | None:
    fractions = halves(results, "small_below_median")
    if fractions is None:
        return None
    return StatementCheck(
        min(fractions) > 0.95, f"small grains below the median of all: {listed(fractions, '.2f')}"
    )


def no_direction(results: Results) -> StatementCheck | None:
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


def no_chains(results: Results) -> StatementCheck | None:
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


def source_pairs(results: Results) -> StatementCheck | None:
    names = [f"source's friction, {mixture_name(a, 0.5)}" for a in ASPECTS]
    found = together(names, "force", results)
    if found is None:
        return None
    gaps = [float(np.ptp(one.values[:2])) for one in found]
    return StatementCheck(max(gaps) <= 0.2, f"they differ by {listed(gaps, '.2f', ' N')}")


def grows_with_ratio(results: Results) -> StatementCheck | None:
    scans = [scan(results, a, "force") for a in ASPECTS]
    if any(one is None for one in scans):
        return None
    known = [one for one in scans if one is not None]
    words = "; ".join(
        f"a = {a:g}: {one[0]:.1f} to {one[-1]:.1f} N" for a, one in zip(ASPECTS, known, strict=True)
    )
    return StatementCheck(
        all(bool((np.diff(one) > -0.01 * one[:-1]).all()) for one in known), words
    )


def grows_as_aspect_falls(results: Results) -> StatementCheck | None:
    forces = halves(results, "force")
    if forces is None:
        return None
    return StatementCheck(forces == sorted(forces), listed(forces, ".1f", " N"))


def nearest(results: Results) -> StatementCheck | None:
    fractions = halves(results, "nearest_species")
    if fractions is None:
        return None
    return StatementCheck(min(fractions) > 0.5, f"fraction of starts: {listed(fractions, '.2f')}")


def hexagons_by_aspect(results: Results) -> StatementCheck | None:
    fractions = halves(results, "hexagons_full")
    if fractions is None:
        return None
    return StatementCheck(fractions == sorted(fractions, reverse=True), listed(fractions, ".2f"))


def least_order(results: Results) -> StatementCheck | None:
    scans = [scan(results, a, "hexagons_full") for a in ASPECTS]
    if any(one is None for one in scans):
        return None
    least = [RATIOS[int(one.argmin())] for one in scans if one is not None]
    return StatementCheck(
        all(0.3 <= one <= 0.7 for one in least), f"least at R = {listed(least, 'g')}"
    )


def variant_forces(results: Results) -> StatementCheck | None:
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


def two_mixtures(results: Results) -> StatementCheck | None:
    scans = [scan(results, 0.75, "force", big) for big in (0.005, 0.008)]
    if scans[0] is None or scans[1] is None:
        return None
    worst = float(np.abs(scans[0] / scans[0][-1] - scans[1] / scans[1][-1]).max())
    return StatementCheck(worst <= 0.05, f"greatest difference {worst:.3f}")


def grain_forces(results: Results) -> StatementCheck | None:
    big, small = halves(results, "big_compression"), halves(results, "small_compression")
    if big is None or small is None:
        return None
    ratios = [s / b for s, b in zip(small, big, strict=True)]
    return StatementCheck(
        max(ratios) < 1.0, f"compressive force, small over big: {listed(ratios, '.2f')}"
    )
