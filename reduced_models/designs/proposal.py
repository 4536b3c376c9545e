"""From a wanted frequency and damping to the damper of which scaling laws expect them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from granular.scene.published_beds import REFERENCE_COUNT
from granular.shared.errors import InputError
from reduced_models.designs.damper import COUNTS, DAMPINGS, LOADS, POWERS, DamperCandidate, scaled_logarithms
from reduced_models.designs.target import DesignTarget

if TYPE_CHECKING:
    from jaxtyping import Float

MARGIN = 1.01
"""Factor by which a frequency may lie beyond the limits: the scaling laws are off by 1.4 % rms."""
SMALLEST = 0.97
"""Frequencies of 92 grains of one size under 8 to 10 kg over those by the laws: 0.95 to 0.99 in 8 falls."""

HEAVY = 8.0
"""Load [kg] from which on fewer grains are taken: heavier pistons press grains of 6 mm to 1.03 of their
contact, and one bed differs from the next."""


def propose_design(target: DesignTarget) -> DamperCandidate:
    """Propose a damper that has the wanted figures by scaling laws; nothing is simulated.

    Parameters
    ----------
    target : DesignTarget
        Wanted frequency [Hz] and damping ratio. With neither grains nor mass fixed, 368 grains are taken if
        a piston of 1.6 to 8 kg does on them, else fewer, and on 92 grains heavier pistons.

    Returns
    -------
    DamperCandidate
        Damper whose frequency and damping ratio are those of the target by the scaling laws, but for the
        rounding of its number of grains.

    Raises
    ------
    InputError
        If a value is out of its range, or no damper within the limits meets the target; the message says
        what can be had.
    """
    target.check_ranges()
    low, high = reachable_frequencies(target)
    fixed = "" if target.grains is None else f" of {target.grains} grains"
    fixed += "" if target.mass is None else f" with a piston of {target.mass:g} kg"
    if not DAMPINGS[0] <= target.damping <= DAMPINGS[1]:
        raise InputError(
            f"damping = {target.damping:g}; dampers reach a damping ratio of {DAMPINGS[0]:g} to "
            f"{DAMPINGS[1]:g}: give one from there"
        )
    if not low <= target.frequency <= high:
        more = ", or leave grains and mass free" if fixed else ""
        raise InputError(
            f"frequency = {target.frequency:g} Hz; dampers{fixed} with a damping ratio of {target.damping:g} "
            f"reach {low:.3g} to {high:.3g} Hz: give one from there{more}, or another small_share"
        )
    return damper_by_laws(target)


def damper_by_laws(
    target: DesignTarget, errors: Float[np.ndarray, "3"] | None = None, grains: int | None = None
) -> DamperCandidate:
    """Damper with the wanted figures by scaling laws whose logarithms have these errors.

    The mass changes first on that number of grains, as far as any piston goes; without one, on 368 grains and
    up to 8 kg. Then the number of grains changes, and at its limit the mass again.
    """
    damper = _limiting_dampers(target)[0]
    wanted = np.log([target.frequency, target.damping])
    if errors is not None:
        wanted -= errors[1:]
    if grains is not None:
        damper = damper._replace(grains=grains)
    numbers = [
        ("mass", LOADS[0], HEAVY if grains is None else LOADS[1]),
        ("grains", *COUNTS),
        ("mass", *LOADS),
    ]
    if target.mass is not None:
        numbers = [("grains", *COUNTS)]
    elif target.grains is not None:
        numbers = [("mass", 0.0, math.inf)]
    for name, low, high in numbers:
        by_grains = POWERS[1] if target.mass is None else POWERS[1] - 0.5 * POWERS[0]
        by_numbers = np.array([POWERS[0] if name == "mass" else by_grains, POWERS[2]])[:, 1:]
        factor = math.exp(np.linalg.solve(by_numbers.T, wanted - scaled_logarithms(damper)[1:])[0])
        load = damper.mass / damper.cell_width_ratio
        if name == "mass":
            number = load = min(max(load * factor, low), high)
        else:
            number = min(max(damper.grains * factor, low), high)
            damper = damper._replace(grains=round(number))
        damper = damper._replace(mass=target.mass or load * damper.cell_width_ratio)
        if low < number < high:
            break
    return _meet_damping(damper, wanted[1])


def _meet_damping(damper: DamperCandidate, wanted: float) -> DamperCandidate:
    """Change the drag to that with the wanted logarithm of the damping ratio by the scaling laws."""
    change = (wanted - scaled_logarithms(damper)[2]) / POWERS[2, 2]
    return damper._replace(drag=damper.drag * math.exp(change))


def reachable_frequencies(target: DesignTarget) -> tuple[float, float]:
    """Lowest and highest frequency [Hz] of dampers with the damping ratio and the numbers of a target."""
    dampers = _limiting_dampers(target)
    low, high = (
        math.exp(scaled_logarithms(_meet_damping(damper, math.log(target.damping)))[1]) for damper in dampers
    )
    few, heavy = dampers[1].grains == COUNTS[0], dampers[1].mass >= HEAVY * dampers[1].cell_width_ratio
    return low / MARGIN, high * (SMALLEST if few and heavy and not target.small_share else MARGIN)


def _limiting_dampers(target: DesignTarget) -> tuple[DamperCandidate, DamperCandidate]:
    """Dampers of the lowest and of the highest frequency within the limits."""
    dampers = []
    for load, count in ((LOADS[0], COUNTS[1]), (LOADS[1], COUNTS[0])):
        grains: float = count if target.grains is None else target.grains
        if target.mass is not None:
            grains = min(max(REFERENCE_COUNT * (target.mass / load) ** 2, COUNTS[0]), COUNTS[1])
        damper = DamperCandidate(load, round(grains), 0.1, target.small_share, target.magnets)
        mass = load * damper.cell_width_ratio if target.mass is None else target.mass
        dampers.append(damper._replace(mass=mass))
    width = dampers[0].cell_width_ratio
    if target.mass is not None and not 0.99 * LOADS[0] <= target.mass / width <= 1.01 * LOADS[1]:
        least = LOADS[0] * math.sqrt(COUNTS[0] / COUNTS[1])
        raise InputError(
            f"mass = {target.mass:g} kg; grains carry {least:.3g} to {LOADS[1]:g} kg: give one from there"
        )
    return dampers[0], dampers[1]
