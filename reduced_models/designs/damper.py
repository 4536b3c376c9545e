"""A damper given by its design parameters, and its oscillation as predicted by scaling laws."""

from __future__ import annotations

import math
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from granular.scene.named_scenes import REFERENCE_COUNT, damper
from granular.scene.scene import Scene
from granular.shared.array_types import Float
from granular.shared.errors import InputError, quote

DIAMETER = 0.006
"""Diameter of a large grain [m], as in the packaged damper."""
ASPECT = 0.6
"""Ratio of the diameters of small and large grains."""
REST_TOLERANCE = "1e-2 D"
"""The piston counts as settled when its height varies by less than this length, a twentieth of the lift. With
1e-3 D instead, frequency and damping differ by less than 0.1 %."""
RELEASE_DURATION = "3 s"
"""Duration of the recorded motion; it contains 7 or more cycles."""
EXPONENT = 2.86
"""Exponent n of the bed's force, proportional to 1/height^n, for the published damper near equilibrium."""

LOADS, COUNTS, DAMPINGS = (1.6, 10.0), (92, 368), (0.023, 0.27)
"""Limits of the load [kg], the number of grains and the damping ratio. The load is the piston's mass divided
by the relative width of the cell. Within these limits, 144 dampers were simulated, and further falls with 1.6
to 2 kg. Under a lighter piston the bed keeps its initial disorder, and dampers differ between packings. A
heavier piston presses small grains into contact. With less damping the bed takes minutes to settle. With more
damping the grains lag behind the piston, and second-order laws no longer agree on frequency and damping."""
LARGEST_SHARE = 0.5
"""Maximum fraction of small grains in the simulated dampers."""
REFERENCE = np.log([7.5, REFERENCE_COUNT, 0.1, 1.0])
"""Logarithms of load [kg], number of grains, drag [kg/s] and (mean mass of grains)/(mass of a large grain),
for the packaged damper."""
REFERENCE_FIGURES = np.log([0.0602, 3.396, 0.0391])
POWERS = np.array(
    [[-0.4, 0.185, -1.185], [0.5, -0.2406, 0.7406], [0.0, 0.0125, 0.9875], [0.8, -0.3825, 1.3825]]
)
"""Exponents of the four numbers in `REFERENCE` (rows) for equilibrium height, frequency and damping ratio
(columns). They hold for a crystal of dipoles (pressure proportional to density^(5/2)) that follows its piston
affinely, with a frequency proportional to (damping ratio)^(1/80). The exponent 1/80 and `REFERENCE_FIGURES`
come from 144 simulated dampers within the limits, with 2 kg or more. The rms errors of the three laws are
2.5, 1.4 and 7.1 %."""
ONE_SIZE = np.array([-0.020, 0.018, -0.055])
"""Errors of the scaling laws for beds of one grain size, as differences of logarithms. They are medians over
the first falls of 15 dampers (`benchmarks.design_targets`), including the packaged damper."""
DISCS = np.log([1.08, 0.95, 1.05])
"""Logarithms of equilibrium height, frequency and damping ratio with discs, each relative to its value with
dipoles. Two packings of the packaged discs between rows of discs have equilibria at 64.4 and 62.7 mm and
frequencies of 3.25 and 3.33 Hz. Damping ratios scale as 1/frequency."""


class DamperCandidate(NamedTuple):
    """A damper, given by its design parameters.

    The parameters are not checked here; methods raise an error for a value out of range.

    Attributes
    ----------
    mass : float
        Mass of the piston [kg], above 0.
    grains : int
        Number of grains, above 0. The cell is 60 D sqrt(grains/368) wide, so that beds of all sizes have
        similar proportions; D = 6 mm is the diameter of a large grain.
    drag : float
        Drag coefficient gamma of a large grain [kg/s], above 0.
    small_share : float
        Fraction of small grains of diameter 0.6 D, from 0 to 1.
    magnets : str
        ``"dipoles"``: point dipoles; or ``"cylinders"``: discs magnetized along their axes.

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
        """Width of the cell relative to the width for 368 grains, sqrt(grains/368), without unit.

        Raises
        ------
        InputError
            If ``grains`` is not a number above 0.
        """
        check_above_zero("grains", self.grains)
        return math.sqrt(self.grains / REFERENCE_COUNT)

    @property
    def viscosity(self) -> float:
        """Viscosity of the liquid for the drag of a large grain, gamma/(3 pi D) [Pa s].

        It follows from Stokes's law for a sphere of diameter D = 6 mm.

        Raises
        ------
        InputError
            If ``drag`` is not a number above 0.
        """
        check_above_zero("drag", self.drag, "kg/s")
        return self.drag / (3.0 * math.pi * DIAMETER)

    def scene(self, seed: int = 1) -> Scene:
        """Scene in which the piston falls, settles, is lifted by 0.2 D and released.

        The piston falls from a height of 20 D sqrt(grains/368), with D = 6 mm.

        Parameters
        ----------
        seed : int
            Seed of the random packing, 0 or more.

        Returns
        -------
        Scene
            Scene with the stages ``drop``, ``lift`` and, for 3 s, ``release``.

        Raises
        ------
        InputError
            If a parameter of the damper is out of range, ``magnets`` is unknown, or ``seed`` is not an
            integer >= 0.
        """
        _check_candidate_ranges(self)
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
            "protocol.release.duration": RELEASE_DURATION,
        }
        if self.small_share > 0.0:
            changes["grains.species"] = [
                {"name": "large", "diameter": DIAMETER, "share": 1.0 - self.small_share},
                {"name": "small", "diameter": ASPECT * DIAMETER, "share": self.small_share},
            ]
        return made.replace(**changes)


def check_above_zero(name: str, value: Any, unit: str = "") -> None:
    """Raise an error unless a value is a finite number above 0."""
    if isinstance(value, bool) or not isinstance(value, Real) or not 0.0 < float(value) < math.inf:
        raise InputError(f"{name} = {quote(value)}; give a number above 0 {unit}".rstrip())


def check_fraction(name: str, value: Any, largest: float) -> None:
    """Raise an error unless a value is a number from 0 to ``largest``."""
    if isinstance(value, bool) or not isinstance(value, Real) or not 0.0 <= float(value) <= largest:
        raise InputError(f"{name} = {quote(value)}; give a fraction from 0 to {largest:g}")


def _check_candidate_ranges(candidate: DamperCandidate) -> None:
    """Raise an error if a parameter of a damper is out of range."""
    check_above_zero("mass", candidate.mass, "kg")
    check_above_zero("grains", candidate.grains)
    check_above_zero("drag", candidate.drag, "kg/s")
    check_fraction("small_share", candidate.small_share, 1.0)


class PredictedOscillationFigures(NamedTuple):
    """Oscillation of a damper as predicted by scaling laws."""

    rest_height: float  # [m]
    frequency: float  # [Hz]
    damping_ratio: float
    lam: float
    k1: float  # of z'' + 2 lam z' + k1 x + k2 x^2 + k3 x^3 = 0, x = displacement from equilibrium (SI)
    k2: float
    k3: float


def logarithms_of_figures_by_scaling_laws(candidate: DamperCandidate) -> Float[np.ndarray, "3"]:
    """Predict the logarithms of equilibrium height [m], frequency [Hz] and damping ratio by scaling laws."""
    _check_candidate_ranges(candidate)
    lighter = 1.0 - candidate.small_share * (1.0 - ASPECT**2)  # moment and drag scale with a grain's mass
    load = candidate.mass / candidate.cell_width_ratio
    numbers = np.log([load, candidate.grains, candidate.drag, lighter])
    discs = DISCS if candidate.magnets == "cylinders" else 0.0
    one_size = 0.0 if candidate.small_share else ONE_SIZE
    return np.asarray(REFERENCE_FIGURES + (numbers - REFERENCE) @ POWERS + discs + one_size)


def predicted_figures_from_logarithms(logarithms: np.ndarray) -> PredictedOscillationFigures:
    """Return all values of the oscillation; the bed's force is proportional to height^(-EXPONENT)."""
    height, frequency, ratio = np.exp(logarithms).tolist()
    k1 = (2.0 * math.pi * frequency) ** 2
    return PredictedOscillationFigures(
        rest_height=height,
        frequency=frequency,
        damping_ratio=ratio,
        lam=ratio * math.sqrt(k1),
        k1=k1,
        k2=-(EXPONENT + 1.0) / 2.0 * k1 / height,
        k3=(EXPONENT + 1.0) * (EXPONENT + 2.0) / 6.0 * k1 / height**2,
    )
