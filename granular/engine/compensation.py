"""Compensated sums: what a sum loses to rounding is kept and enters the next one.

Kahan, Commun. ACM 8 (1965) 40; for integrators Hairer, Lubich and Wanner, Geometric Numerical
Integration (2006), VIII.5.
"""

from __future__ import annotations

from granular.compiled import compiled


@compiled
def compensated_sum(total: float, rounding: float, increment: float) -> tuple[float, float]:
    """The new total, and what rounding took from it."""
    wanted = increment + rounding
    new = total + wanted
    return new, wanted - (new - total)
