"""A wanted frequency and damping, and the numbers that are fixed."""

from __future__ import annotations

from numbers import Integral
from typing import NamedTuple

from granular.shared.errors import InputError
from granular.shared.message_text import quote
from reduced_models.designs.damper import COUNTS, LARGEST_SHARE, check_above_zero, check_fraction


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

        A target that passes may still be out of reach: see `propose_design`.

        Raises
        ------
        InputError
            If frequency, damping or mass is no finite number above 0, grains and mass are both
            fixed, grains is no integer from 92 to 368, the fraction of small ones is not from 0 to
            0.5, or there are no such magnets.
        """
        check_above_zero("frequency", self.frequency, "Hz")
        check_above_zero("damping", self.damping)
        if self.mass is not None:
            check_above_zero("mass", self.mass, "kg")
        if self.grains is not None and self.mass is not None:
            raise InputError(
                f"grains = {quote(self.grains)} and mass = {quote(self.mass)} fix the frequency already; "
                "give one of them, or none"
            )
        low, high = COUNTS
        if self.grains is not None and not (isinstance(self.grains, Integral) and low <= self.grains <= high):
            raise InputError(f"grains = {quote(self.grains)}; give an integer from {low} to {high}")
        check_fraction("small_share", self.small_share, LARGEST_SHARE)
        if self.magnets not in ("dipoles", "cylinders"):
            raise InputError(f"magnets = {quote(self.magnets)}; give 'dipoles' or 'cylinders'")
