"""Steps of a damper's numbers to a wanted frequency and damping, along powers of its figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from reduced_models.designs.damper import COUNTS, LOADS, POWERS, DamperCandidate

if TYPE_CHECKING:
    from jaxtyping import Float

    from reduced_models.designs.target import DesignTarget

LONGEST = 0.2
"""Longest step of the logarithm of mass or number of grains along the slopes of one bed: that of frequency by
mass changes by 0.15 over a fifth more mass."""


class Step(NamedTuple):
    """A stepped damper."""

    damper: DamperCandidate
    logarithms: Float[np.ndarray, "3"]  # of its expected rest height [m], frequency [Hz] and damping ratio
    cut: int  # 1 or -1 if the longest step up or down ended it, else 0


def step_damper(
    target: DesignTarget,
    damper: DamperCandidate,
    logarithms: Float[np.ndarray, "3"],
    slopes: Float[np.ndarray, "2 3"] = POWERS[[0, 2]],
    longest: float = math.inf,
) -> Step:
    """Step a damper with known figures to the target, by their slopes over mass and drag.

    A free mass or number of grains stays within its limits; the mass changes on 368 grains, and where the
    number of grains is at its limit.
    """
    by_mass, by_drag = slopes
    numbers = ["mass", "grains"] if damper.grains == COUNTS[1] else ["grains", "mass"]
    free = [name for name in numbers if getattr(target, name) is None]
    if len(free) < 2:
        free = ["grains"] if target.grains is None else ["mass"]
    for name in free:
        by_grains = POWERS[1] if target.mass is None else POWERS[1] - 0.5 * by_mass
        by_number = by_mass if name == "mass" else by_grains
        change = float(np.linalg.solve(np.array([by_number, by_drag])[:, 1:].T, _miss(target, logarithms))[0])
        cut = int(np.sign(change)) if abs(change) > longest else 0
        factor = math.exp(min(max(change, -longest), longest))
        if name == "mass":
            low, high = LOADS if len(free) > 1 else (0.0, math.inf)
            number = min(max(damper.mass / damper.cell_width_ratio * factor, low), high)
            after = damper._replace(mass=number * damper.cell_width_ratio)
            logarithms = logarithms + by_mass * math.log(after.mass / damper.mass)
        else:
            low, high = COUNTS
            number = min(max(damper.grains * factor, low), high)
            after = damper._replace(grains=round(number))
            if target.mass is None:
                after = after._replace(mass=damper.mass * after.cell_width_ratio / damper.cell_width_ratio)
            logarithms = logarithms + by_grains * math.log(after.grains / damper.grains)
        damper = after
        if low < number < high:
            break
    return Step(*meet_damping(target, damper, logarithms, by_drag), cut)


def meet_damping(
    target: DesignTarget, damper: DamperCandidate, logarithms: np.ndarray, by_drag: np.ndarray
) -> tuple[DamperCandidate, np.ndarray]:
    """Change the drag to that with the wanted damping ratio; also give the figures then."""
    change = _miss(target, logarithms)[1] / by_drag[2]
    return damper._replace(drag=damper.drag * math.exp(change)), logarithms + change * by_drag


def mean_damper(steps: Sequence[Step]) -> DamperCandidate:
    """Return the geometric mean of mass per width, number of grains and drag of steps to one target.

    First steps that were cut do not lead to the target: they count from the last before a step back on.
    """
    while len(steps) > 1 and steps[0].cut and steps[1].cut != -steps[0].cut:
        steps = steps[1:]
    dampers = [step.damper for step in steps]
    powers = [
        np.log([damper.mass / damper.cell_width_ratio, damper.grains, damper.drag / damper.grains**-0.75])
        for damper in dampers
    ]
    load, grains, drag = np.exp(np.mean(powers, axis=0)).tolist()
    mean = dampers[-1]._replace(grains=round(grains))
    mass = mean.mass if len({damper.mass for damper in dampers}) == 1 else load * mean.cell_width_ratio
    return mean._replace(mass=mass, drag=drag * mean.grains**-0.75)


def _miss(target: DesignTarget, logarithms: np.ndarray) -> np.ndarray:
    return np.asarray(np.log([target.frequency, target.damping]) - logarithms[1:])
