"""A damper as a designer sees it, and the box of dampers that the maps cover.

Inside the box a damper is a point of four coordinates from -1 to 1, in which its figures are
smooth: mass of the piston over the width of the cell, number of grains, affine damping ratio, and
fraction of small grains.
"""

from __future__ import annotations

import math
import warnings
from numbers import Real
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.scene.published_beds import REFERENCE_COUNT, damper
from granular.scene.scene import Scene
from granular.shared.errors import InputError
from granular.shared.message_text import quote

if TYPE_CHECKING:
    from jaxtyping import Float

GRAVITY = 9.8
"""[m/s²], as in the packaged scenes."""
DIAMETER = 0.006
"""Diameter of a large grain [m], as in the packaged damper."""
ASPECT = 0.6
"""Diameter of small grains over that of large ones."""
REST_TOLERANCE = "1e-3 D"
"""The piston is at rest when it stays within this height: 1/200 of the lift."""
SWING = "3 s"
"""Length of the recorded motion: at least seven swings."""

REFERENCE_MASS = 7.5
REFERENCE_REST = 9.86 * DIAMETER
EXPONENT = 2.86
"""The published damper rests at 9.86 D; the force of the bed falls with this power of the height
there (tests/regression/test_damper.py)."""

LOWEST = (2.0, 92.0, 0.023, 0.0)
HIGHEST = (10.0, 368.0, 0.25, 0.5)
"""The box: mass of the piston for 368 grains [kg], grains, affine damping ratio, fraction of small
grains. Under a lighter piston the bed keeps the disorder of its start, and one damper differs from
the next; a heavier one presses small grains into contact. Less damping takes minutes to come to
rest; with more of it grains lag behind the piston, and laws of second order no longer agree on
frequency and damping."""
NAMES = ("mass for 368 grains", "grains", "affine damping ratio", "fraction of small grains")


class DamperCandidate(NamedTuple):
    """A damper, by the figures that a designer chooses.

    They are not checked here: methods refuse what is out of its range.

    Attributes
    ----------
    mass : float
        Mass of the piston [kg], above 0.
    grains : int
        Number of grains, above 0; the cell is as wide as keeps the packing, 60 D sqrt(grains/368),
        where D = 6 mm is the diameter of a large grain.
    drag : float
        Drag coefficient gamma of a large grain [kg/s], above 0.
    small_share : float
        Fraction of the grains that are small, of the diameter 0.6 D, from 0 to 1.
    magnets : str
        ``"dipoles"``: point dipoles; or ``"cylinders"``: discs, magnetized along their axes.

    Examples
    --------
    >>> from reduced_models import DamperCandidate
    >>> DamperCandidate(mass=4.0, grains=184, drag=0.1, small_share=0.3).grains
    184
    """

    mass: float
    grains: int
    drag: float
    small_share: float = 0.0
    magnets: str = "dipoles"

    @property
    def cell_width_ratio(self) -> float:
        """Width of the cell over that for 368 grains, sqrt(grains/368), without unit.

        Raises
        ------
        InputError
            If ``grains`` is no number above 0.
        """
        _check_above_zero("grains", self.grains)
        return math.sqrt(self.grains / REFERENCE_COUNT)

    @property
    def viscosity(self) -> float:
        """Viscosity of the liquid that gives a large grain its drag, gamma/(3 pi D) [Pa s].

        By Stokes's law for a sphere of the diameter D = 6 mm.

        Raises
        ------
        InputError
            If ``drag`` is no number above 0.
        """
        _check_above_zero("drag", self.drag, "kg/s")
        return self.drag / (3.0 * math.pi * DIAMETER)

    def scene(self, seed: int = 1) -> Scene:
        """Scene of the damper that falls, comes to rest, is lifted by 0.2 D and released.

        The fall begins at 20 D sqrt(grains/368); D = 6 mm.

        Parameters
        ----------
        seed : int
            Seed of the random start, from 0 on.

        Returns
        -------
        Scene
            Scene with the stages ``drop``, ``lift`` and, for 3 s, ``release``.

        Raises
        ------
        InputError
            If a figure of the damper is out of its range, there are no such magnets, or ``seed`` is
            no integer from 0 on.
        """
        _check_figures(self)
        made = damper(
            self.mass / self.cell_width_ratio,
            count=self.grains,
            drag=self.drag,
            seed=seed,
            magnets=self.magnets,
        )
        changes: dict[str, Any] = {
            "name": "design",
            "protocol.drop.tolerance": REST_TOLERANCE,
            "protocol.release.duration": SWING,
        }
        if self.small_share > 0.0:
            changes["grains.species"] = [
                {"name": "large", "diameter": DIAMETER, "share": 1.0 - self.small_share},
                {"name": "small", "diameter": ASPECT * DIAMETER, "share": self.small_share},
            ]
        return made.replace(**changes)

    def map_coordinates(self) -> np.ndarray:
        """Coordinates of the damper in the box that the maps cover.

        Returns
        -------
        float64 (4,)
            Mass of the piston over `cell_width_ratio`, number of grains and affine damping ratio
            (that of grains which all follow the piston in proportion to their heights), on
            logarithmic scales, and fraction of small grains; without unit, from -1 to 1 inside the
            box.

        Raises
        ------
        InputError
            If mass, grains or drag is no number above 0, or the fraction is not from 0 to 1.
        """
        _check_figures(self)
        plain = (self.mass / self.cell_width_ratio, self.grains, affine_damping_ratio(self), self.small_share)
        low, high = _logarithmic_coordinates(LOWEST), _logarithmic_coordinates(HIGHEST)
        return 2.0 * (_logarithmic_coordinates(plain) - low) / (high - low) - 1.0


def _check_above_zero(name: str, value: Any, unit: str = "") -> None:
    if isinstance(value, bool) or not isinstance(value, Real) or not 0.0 < float(value) < math.inf:
        raise InputError(f"{name} = {quote(value)}; give a number above 0 {unit}".rstrip())


def _check_figures(candidate: DamperCandidate) -> None:
    """Refuse figures of a damper that are out of their ranges."""
    _check_above_zero("mass", candidate.mass, "kg")
    _check_above_zero("grains", candidate.grains)
    _check_above_zero("drag", candidate.drag, "kg/s")
    fraction: Any = candidate.small_share
    if not (isinstance(fraction, Real) and 0.0 <= float(fraction) <= 1.0):
        raise InputError(f"small_share = {quote(fraction)}; give a fraction from 0 to 1")


def damper_at_coordinates(coordinates: Float[np.ndarray, "4"]) -> DamperCandidate:
    """Damper at a place of the box that the maps cover; its number of grains is rounded."""
    low, high = _logarithmic_coordinates(LOWEST), _logarithmic_coordinates(HIGHEST)
    scaled = low + 0.5 * (np.asarray(coordinates, dtype=float) + 1.0) * (high - low)
    mass, count, ratio = (math.exp(log) for log in scaled[:3])
    plain = DamperCandidate(mass, round(count), 1.0, float(scaled[3]))
    plain = plain._replace(mass=mass * plain.cell_width_ratio)
    return plain._replace(drag=ratio / affine_damping_ratio(plain))


def disc_over_dipole_figures(candidate: DamperCandidate) -> Float[np.ndarray, "3"]:
    """Rest height, frequency and damping ratio of discs over those of dipoles, by theory (3,)."""
    from reduced_models.falls.predicted_law import OutsideRangeWarning, predict

    if candidate.magnets == "dipoles":
        return np.ones(3)
    figures = []
    for magnets in (candidate.magnets, "dipoles"):
        with warnings.catch_warnings():
            # Fewer grains than were compared with falls: the ratio is that of two lattices.
            warnings.simplefilter("ignore", OutsideRangeWarning)
            rest = predict(candidate._replace(magnets=magnets).scene()).at_rest
        assert rest is not None
        figures.append([rest.height, 1.0 / rest.period, rest.damping_ratio])
    return np.array(figures[0]) / np.array(figures[1])


def affine_rest_height(candidate: DamperCandidate) -> float:
    """Height at which a bed of the reference's packing would carry the piston [m]."""
    # The force of N grains falls with the power 2.86 of the height, and grows with the square of their mean
    # moment.
    load = (
        candidate.mass / candidate.cell_width_ratio / REFERENCE_MASS / _mean_grain_mass_ratio(candidate) ** 2
    )
    return REFERENCE_REST * candidate.cell_width_ratio * load ** (-1.0 / EXPONENT)


def affine_damping_ratio(candidate: DamperCandidate) -> float:
    """Damping ratio if every grain followed the piston in proportion to its height."""
    # A grain at y then moves with y/h of the piston's velocity: the drag is a third of the grains' sum, and
    # the frequency sqrt(2.86 g/h).
    frequency = math.sqrt(EXPONENT * GRAVITY / affine_rest_height(candidate))
    drag = candidate.grains * candidate.drag * _mean_grain_mass_ratio(candidate) / 3.0
    return drag / (2.0 * candidate.mass * frequency)


def _mean_grain_mass_ratio(candidate: DamperCandidate) -> float:
    """Mean mass over that of a large grain; moment and drag go with it, for one material [D, eq. 4.16]."""
    return 1.0 - candidate.small_share * (1.0 - ASPECT**2)


def _logarithmic_coordinates(plain: tuple[float, ...]) -> np.ndarray:
    return np.array([*np.log(plain[:3]), plain[3]])
