"""What the source says without a number, tested on the runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from validation.published.measures import together
from validation.published.plan import (
    ASPECTS,
    RATIOS,
    SPEEDS,
    VARIANT_RATIOS,
    VARIANTS,
    mixture_name,
)
from validation.published.results import Results


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
        Statement("3.3", "the force does not depend on the piston's speed, 8.33 to 128 mm/s",
                  _speeds),
        Statement("3.4", "torque of second order changes F/F_max little", _second_order),
        Statement("3.4", "high friction (0.8) makes the hysteresis of the mean distance much "
                  "greater", _high_friction),
        Statement("3.4, 4.3.1", "greater friction needs a greater force at the same packing",
                  _friction_force),
        Statement("4.3.1", "F_max grows with R", _grows_with_ratio),
        Statement("4.3.1", "F_max grows as a falls", _grows_as_aspect_falls),
        Statement("4.3.1", "at R = 0.5 the grain nearest to the piston is a small one", _nearest),
        Statement("4.3.2", "the share of hexagons falls with a", _hexagons_by_aspect),
        Statement("4.3.2", "pure beds are ordered, mixtures near R = 0.5 least", _least_order),
        Statement("4.3.3", "drag and weightlessness change the force little", _variant_forces),
        Statement("4.3.4", "two mixtures of a = 0.75, of 5 and of 8 mm, have the same F(R)/F(1)",
                  _two_mixtures),
        Statement("4.3.5", "small grains feel smaller forces than big ones", _grain_forces),
    )  # fmt: skip


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


def _pair(results: Results, figure: str, first: str, second: str) -> tuple[float, float] | None:
    found = together([first, second], figure, results)
    return None if found is None else (found[0].values.mean(), found[1].values.mean())


def _reference(results: Results) -> str:
    """The bed with the source's friction at the same speed."""
    return "starts" if results.best("starts") == results.best("second order") else "direct 368"


def _second_order(results: Results) -> StatementCheck | None:
    """The source compares forces over their greatest."""
    pair = _pair(results, "force", _reference(results), "second order")
    names = (_reference(results), "second order")
    courses = [_course(results, name, results.best(*names)) for name in names]
    if pair is None or courses[0] is None or courses[1] is None:
        return None
    worst = float(np.abs(courses[0] - courses[1]).max())
    return StatementCheck(
        worst <= 0.05,
        f"F/F_max differs by at most {worst:.3f}; F_max itself is {pair[0]:.2f} N to first and "
        f"{pair[1]:.2f} N to second order",
    )


def _course(results: Results, name: str, protocol: str | None) -> np.ndarray | None:
    """Mean force over its greatest, down and up."""
    courses = [np.array(results.lists(name, way, protocol)) for way in ("down", "up")]
    if any(one.ndim != 2 for one in courses):
        return None
    course = np.concatenate([one.mean(axis=0) for one in courses])
    return np.asarray(course / course.max())


def _hysteresis(results: Results, name: str, protocol: str | None) -> float | None:
    end = results.sample(name, "half_end_D", protocol)
    start = results.sample(name, "half_start_D", protocol)
    if end is None or start is None:
        return None
    return float(start.values.mean() - end.values.mean())


def _high_friction(results: Results) -> StatementCheck | None:
    usual, high = _reference(results), "second order, 0.8"
    protocol = results.best(usual, high)
    before, after = (_hysteresis(results, name, protocol) for name in (usual, high))
    if before is None or after is None:
        return None
    return StatementCheck(
        after > 1.2 * before, f"{before:.2f} D with 0.6 and 0.45, {after:.2f} D with 0.8"
    )


def _friction_force(results: Results) -> StatementCheck | None:
    names = ["drag", _reference(results), "second order, 0.8"]
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
    big, small = _halves(results, "big_force"), _halves(results, "small_force")
    if big is None or small is None:
        return None
    ratios = [s / b for s, b in zip(small, big, strict=True)]
    return StatementCheck(max(ratios) < 1.0, f"small over big: {_listed(ratios, '.2f')}")
