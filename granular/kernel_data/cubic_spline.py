"""Cubic spline on equidistant knots, by its values and slopes there."""

from __future__ import annotations

from granular.compiled import Array, compiled


@compiled
def evaluate_cubic_spline(values: Array, slopes: Array, h: float, time: float) -> tuple[float, float]:
    """Value and slope at a time from the first knot; behind its ends what they are; h the knots' distance."""
    k = min(max(int(time / h), 0), values.size - 2)
    s = min(max(time / h - k, 0.0), 1.0)
    rise, left, right = values[k + 1] - values[k], h * slopes[k], h * slopes[k + 1]
    bend, twist = 3.0 * rise - 2.0 * left - right, left + right - 2.0 * rise
    return values[k] + s * (left + s * (bend + s * twist)), (left + s * (2.0 * bend + 3.0 * s * twist)) / h
