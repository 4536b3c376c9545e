"""The catalogue of hard cases: what is hard, what counts as accurate, which errors may end it.

Only coincident grains, overlapping starts without contact, numbers that are none or cannot be
computed with, a piston started inside the bed, steps beyond the stability limit, and de Paula's
list of pairs, which misses some, may end in an error. All others run accurately with the default
settings.
"""

from __future__ import annotations

from validation.hard_cases.beds import pair_sum_cases, piston_cases, size_cases
from validation.hard_cases.extreme_values import (
    extreme_cases,
    non_finite_cases,
    small_count_cases,
    uncomputable_cases,
)
from validation.hard_cases.friction import friction_cases
from validation.hard_cases.hard_case import HardCase, energy_change
from validation.hard_cases.one_and_two_grains import (
    collision_cases,
    damping_cases,
    distance_from_verlet_swing,
    head_on_collision,
    mass_cases,
    scene_near_stability_limit,
    start_cases,
    step_cases,
)

__all__ = [
    "COSTLY",
    "distance_from_verlet_swing",
    "energy_change",
    "hard_case_catalogue",
    "head_on_collision",
    "scene_near_stability_limit",
]

COSTLY = (
    "slabs",
    "friction",
    "mass ratio",
    "aspect",
    "contact",
    "drop",
    "100 kg",
    "packing",
    "skin",
    "far field",
    "1e6 steps",
    "damping ratio",
    "three species",
    "list of pairs",
    "1e5 grains",
)
"""Words in the names of hard cases whose scenes take long to compile or to run."""


def hard_case_catalogue() -> tuple[HardCase, ...]:
    """Return all hard cases.

    Returns
    -------
    tuple of HardCase
        Cases in the order of the report.

    Examples
    --------
    >>> from validation import hard_case_catalogue
    >>> len(hard_case_catalogue()) > 10
    True
    """
    return (
        *piston_cases(),
        *collision_cases(),
        *start_cases(),
        *friction_cases(),
        *damping_cases(),
        *mass_cases(),
        *size_cases(),
        *step_cases(),
        *small_count_cases(),
        *pair_sum_cases(),
        *extreme_cases(),
        *uncomputable_cases(),
        *non_finite_cases(),
    )
