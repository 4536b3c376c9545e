"""Verdicts: scatter, tolerance, bounds, and what cannot be judged."""

from __future__ import annotations

import math

import pytest

from validation.published.entry import Rule, verdict
from validation.published.finding import Finding

FORCE = Rule(relative=0.03)


def found(value: float, spread: float | None = None, starts: int = 3) -> Finding:
    return Finding(value, spread, starts, "quick", "auto")


@pytest.mark.parametrize(
    ("ours", "words"),
    [
        (15.26, "agrees within scatter"),
        (15.26 + 2 * math.hypot(0.24, 0.1), "agrees within scatter"),
        (15.26 - 2 * math.hypot(0.24, 0.1), "agrees within scatter"),
        (15.26 + 0.53, "differs"),
        (15.26 - 0.53, "differs"),
    ],
)
def test_scatter_is_that_of_both(ours: float, words: str) -> None:
    assert verdict(15.26, 0.24, found(ours, 0.1), Rule(), 2).words == words


def test_half_of_the_last_digit_is_rounding() -> None:
    assert verdict(0.92, None, found(0.9249, 0.0), Rule(), 2).agrees
    assert not verdict(0.92, None, found(0.9251, 0.0), Rule(), 2).agrees
    assert verdict(0.920, None, found(0.9206, 0.0), Rule(), 3).agrees is False


def test_a_tolerance_counts_outside_of_the_scatter() -> None:
    near, far = found(36.24 * 1.029, 0.01), found(36.24 * 1.031, 0.01)
    assert verdict(36.24, math.nan, near, FORCE, 2).words == "agrees within 3 %"
    assert verdict(36.24, math.nan, far, FORCE, 2).words == "differs"
    assert verdict(-3.0, None, found(-4.2, 0.01), Rule(absolute=1.5), 2).words == (
        "agrees within 1.5"
    )


def test_bounds_are_bounds() -> None:
    least = Rule(limit="least")
    assert verdict(0.97, None, found(0.99), least, 2) == ("holds", True)
    assert verdict(0.97, None, found(0.9699), least, 2) == ("differs", False)
    assert verdict(0.02, None, found(0.03), Rule(limit="most"), 2).agrees is False


def test_what_was_not_run_or_cannot_be_compared_has_no_verdict() -> None:
    assert verdict(1.0, None, None, FORCE, 2) == ("not run yet", None)
    assert verdict(1.0, None, found(math.nan), FORCE, 2) == ("not run yet", None)
    assert verdict(18.0, None, found(0.01), Rule(comparable=False), 1) == ("not comparable", None)
    assert verdict(18.0, None, None, Rule(comparable=False), 1).words == "not run yet"
