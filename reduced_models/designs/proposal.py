"""From a wanted frequency and damping to the damper that the maps promise them of."""

from __future__ import annotations

import math
from collections.abc import Callable
from numbers import Integral, Real
from typing import NamedTuple

import numpy as np

from granular.scene.published_beds import REFERENCE_COUNT
from granular.shared.errors import InputError
from granular.shared.message_text import quote
from reduced_models.designs.damper import (
    HIGHEST,
    LOWEST,
    DamperCandidate,
    damper_at_coordinates,
    disc_over_dipole_figures,
)
from reduced_models.designs.maps import DamperMaps

_MET = 1e-4
_ROUNDS = 4
"""Rounds in which the factors between discs and dipoles settle: they hardly change from damper to damper."""
_GRID = np.linspace(-1.0, 1.0, 33)
COUNTS = tuple(round(count) for count in np.geomspace(HIGHEST[1], LOWEST[1], 24))
"""Numbers of grains that are tried, in this order, where none is given."""


class DesignTarget(NamedTuple):
    """Figures that a damper shall have, and what of it is fixed.

    They are not checked here: `check_ranges` refuses what is out of its range.

    Attributes
    ----------
    frequency : float
        Frequency of the undamped small swing about rest [Hz], above 0.
    damping : float
        Damping ratio, a fraction of critical damping, above 0.
    grains : int or None
        Number of grains, from 92 to 368; None where it is free.
    mass : float or None
        Mass of the piston [kg], above 0; None where it is free. At most one of both is fixed.
    small_share : float
        Fraction of grains with 0.6 of the diameter, from 0 to 0.5.
    magnets : str
        ``"dipoles"``, or ``"cylinders"``: discs.
    """

    frequency: float
    damping: float
    grains: int | None = None
    mass: float | None = None
    small_share: float = 0.0
    magnets: str = "dipoles"

    def check_ranges(self) -> None:
        """Refuse values out of their ranges.

        A target that passes may still be none that the maps of dampers hold: see `propose_design`.

        Raises
        ------
        InputError
            If frequency, damping or mass is no finite number above 0, grains and mass are both
            fixed, grains is no integer from 92 to 368, the fraction of small ones is not from 0 to
            0.5, or there are no such magnets.
        """
        for name, value, unit in (
            ("frequency", self.frequency, " Hz"),
            ("damping", self.damping, ""),
            ("mass", self.mass, " kg"),
        ):
            if value is None and name == "mass":
                continue
            if value is None or not _is_number(value) or not 0.0 < value < math.inf:
                raise InputError(f"{name} = {quote(value)}; give a number above 0{unit}")
        if self.grains is not None and self.mass is not None:
            raise InputError(
                f"grains = {quote(self.grains)} and mass = {quote(self.mass)} fix the frequency "
                "already; "
                "give one of them, or none"
            )
        low, high = int(LOWEST[1]), int(HIGHEST[1])
        if self.grains is not None and not (isinstance(self.grains, Integral) and low <= self.grains <= high):
            raise InputError(f"grains = {quote(self.grains)}; give an integer from {low} to {high}")
        if not (_is_number(self.small_share) and 0.0 <= self.small_share <= HIGHEST[3]):
            raise InputError(
                f"small_share = {quote(self.small_share)}; give a fraction from 0 to {HIGHEST[3]:g}"
            )
        if self.magnets not in ("dipoles", "cylinders"):
            raise InputError(f"magnets = {quote(self.magnets)}; give 'dipoles' or 'cylinders'")


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


Coordinates = Callable[[float, float], np.ndarray | None]
"""Two numbers from -1 to 1 -> a place in the box; None outside it."""


def propose_design(maps: DamperMaps, target: DesignTarget) -> DamperCandidate:
    """Propose a damper that has the wanted figures by the maps; nothing is simulated.

    Parameters
    ----------
    maps : DamperMaps
        Maps of a study of dampers.
    target : DesignTarget
        Wanted frequency [Hz] and damping ratio. With neither grains nor mass fixed, 24 numbers of
        grains from 368 down to 92 are tried, and the first that does is taken.

    Returns
    -------
    DamperCandidate
        Damper inside the box of the maps, whose frequency and damping ratio there are those of the
        target but for the rounding of its number of grains.

    Raises
    ------
    InputError
        If a value is out of its range, no damper of the maps meets the target (the message tells
        what can be had), or the piston of one with discs presses them together.
    """
    target.check_ranges()
    aim = (target.frequency, target.damping)
    dampers = (
        damper_for_target(maps, candidate_target, aim) for candidate_target in targets_by_grain_count(target)
    )
    first = next((damper for damper in dampers if damper is not None), None)
    if first is None:
        raise InputError(_unreachable_target_text(maps, target))
    return first


def targets_by_grain_count(target: DesignTarget) -> list[DesignTarget]:
    """Targets with each number of grains that may be tried; the target itself if it names one."""
    if target.grains is not None or target.mass is not None:
        return [target]
    return [target._replace(grains=count) for count in COUNTS]


def damper_for_target(
    maps: DamperMaps, target: DesignTarget, aim: tuple[float, float]
) -> DamperCandidate | None:
    """Damper to which the maps give the aim's frequency [Hz] and damping ratio; None if there is none."""
    # The aim differs from the target once simulations have shown that the maps are a little off.
    positions = _coordinates_for(target)
    damper = _solve_for_damper(maps, positions, aim)
    for _ in range(0 if target.magnets == "dipoles" else _ROUNDS):
        if damper is None:
            break
        factors = disc_over_dipole_figures(damper._replace(magnets=target.magnets))
        damper = _solve_for_damper(maps, positions, (aim[0] / factors[1], aim[1] / factors[2]))
    if damper is None:
        return None
    return damper._replace(magnets=target.magnets, mass=damper.mass if target.mass is None else target.mass)


def _coordinates_for(target: DesignTarget) -> Coordinates:
    """Ways through the box on which mass and drag, or grains and drag, are free."""
    fraction = _to_unit_interval(target.small_share, LOWEST[3], HIGHEST[3])
    if target.mass is not None:
        return _coordinates_of_mass(target.mass, fraction)
    assert target.grains is not None
    return _coordinates_of_grains(target.grains, fraction)


def _coordinates_of_grains(count: float, fraction: float) -> Coordinates:
    grains = _to_unit_interval(math.log(count), math.log(LOWEST[1]), math.log(HIGHEST[1]))
    return lambda mass, drag: np.array([mass, grains, drag, fraction])


def _coordinates_of_mass(mass: float, fraction: float) -> Coordinates:
    def coordinates_at(grains: float, drag: float) -> np.ndarray | None:
        low, high = math.log(LOWEST[1]), math.log(HIGHEST[1])
        count = math.exp(low + 0.5 * (grains + 1.0) * (high - low))
        load = mass / math.sqrt(count / REFERENCE_COUNT)
        position = _to_unit_interval(math.log(load), math.log(LOWEST[0]), math.log(HIGHEST[0]))
        return None if abs(position) > 1.0 else np.array([position, grains, drag, fraction])

    return coordinates_at


def _to_unit_interval(value: float, low: float, high: float) -> float:
    return 2.0 * (value - low) / (high - low) - 1.0


def _solve_for_damper(
    maps: DamperMaps, positions: Coordinates, aim: tuple[float, float]
) -> DamperCandidate | None:
    """Damper of a family that meets the aim; None if there is none."""
    from scipy.optimize import least_squares

    wanted = np.log(aim)

    def misses(free: np.ndarray) -> np.ndarray:
        position = positions(*free)
        if position is None:
            return np.full(2, 1e3)
        return np.array([maps.figure_at(name, position) for name in ("frequency", "damping_ratio")]) - wanted

    start = min(
        (np.array([coordinate, other]) for coordinate in _GRID[::4] for other in _GRID[::4]),
        key=lambda free: float(np.abs(misses(free)).max()),
    )
    solution = least_squares(misses, start, bounds=(-1.0, 1.0), xtol=1e-12)
    if np.abs(solution.fun).max() > _MET:
        return None
    point = positions(*solution.x)
    assert point is not None
    return damper_at_coordinates(point)


def _unreachable_target_text(maps: DamperMaps, target: DesignTarget) -> str:
    """Why there is no such damper, and what can be had."""
    pairs = np.array(
        [
            [maps.figure_at(name, index) for name in ("frequency", "damping_ratio")]
            for narrow in [*targets_by_grain_count(target)[::4], targets_by_grain_count(target)[-1]]
            for item in _GRID
            for other in _GRID
            if (index := _coordinates_for(narrow)(item, other)) is not None
        ]
    )
    fixed = "the maps hold no damper"
    if target.mass is not None and not len(pairs):
        least = LOWEST[0] * math.sqrt(LOWEST[1] / REFERENCE_COUNT)
        return (
            f"mass = {target.mass:g} kg; {fixed} with this piston: give a mass from {least:.3g} to "
            f"{HIGHEST[0]:g} kg"
        )
    if target.grains is not None:
        fixed += f" of {target.grains} grains"
    if target.mass is not None:
        fixed += f" with a piston of {target.mass:g} kg"
    frequencies, ratios = np.exp(pairs).T
    if not ratios.min() <= target.damping <= ratios.max():
        return (
            f"damping = {target.damping:g}; {fixed} with that damping ratio: give one from "
            f"{ratios.min():.3g} to {ratios.max():.3g}"
        )
    near = np.abs(np.log(ratios / target.damping)) < 0.1
    low, high = frequencies[near].min(), frequencies[near].max()
    more = "" if target.grains is None and target.mass is None else ", or leave grains and mass free"
    return (
        f"frequency = {target.frequency:g} Hz with a damping ratio of {target.damping:g}; {fixed} "
        f"of that kind: give a frequency from {low:.3g} to {high:.3g} Hz{more}, or another "
        "small_share"
    )
