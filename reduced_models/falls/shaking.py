"""How far the law of a bed that orders may stand in for the bed under shaking.

The pushed piston of the packaged damper beside the law ``annealing-bed``: fallen from 20 D to rest
(for 368 grains; all lengths times sqrt(N/368)), then pushed by F sin(2 pi f t) for six cycles or
two seconds, whichever is longer. The response is half the range of the last three cycles.

At 3 D it is no longer told: the law's response is 0.94 to 1.16 of the simulated one for 368 grains,
and for 736 grains only 0.79 of it at 5 Hz, 0.60 at 8 Hz. The range ends at 1.5 D.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from reduced_models.falls.theory import parameters_of

if TYPE_CHECKING:
    from granular.scene.scene import Scene


class Pushed(NamedTuple):
    """A pushed piston, simulated and by the law.

    Attributes
    ----------
    grains : int
        N.
    frequency, force : float
        f [Hz] and F [N].
    simulated, by_law : float
        Response [D sqrt(N/368)].
    """

    grains: int
    frequency: float
    force: float
    simulated: float
    by_law: float


PUSHED = (
    Pushed(368, 1.0, 9.6, 0.499, 0.504),
    Pushed(368, 1.0, 23.9, 1.476, 1.471),
    Pushed(368, 1.0, 35.8, 3.164, 3.084),
    Pushed(368, 2.0, 6.5, 0.498, 0.5),
    Pushed(368, 2.0, 19.4, 1.456, 1.471),
    Pushed(368, 2.0, 36.4, 3.016, 3.076),
    Pushed(368, 3.5, 1.0, 0.488, 0.489),
    Pushed(368, 3.5, 3.5, 1.595, 1.542),
    Pushed(368, 3.5, 9.3, 2.582, 2.973),
    Pushed(368, 5.0, 8.8, 0.508, 0.508),
    Pushed(368, 5.0, 30.0, 1.625, 1.5),
    Pushed(368, 5.0, 63.9, 3.058, 2.999),
    Pushed(368, 8.0, 31.7, 0.508, 0.512),
    Pushed(368, 8.0, 122.3, 1.668, 1.517),
    Pushed(368, 8.0, 183.2, 3.176, 2.987),
    Pushed(736, 1.0, 13.6, 0.491, 0.498),
    Pushed(736, 1.0, 34.6, 1.496, 1.496),
    Pushed(736, 1.0, 53.6, 3.039, 3.034),
    Pushed(736, 2.0, 8.1, 0.513, 0.504),
    Pushed(736, 2.0, 23.5, 1.453, 1.469),
    Pushed(736, 2.0, 42.7, 3.204, 3.059),
    Pushed(736, 3.5, 6.3, 0.455, 0.499),
    Pushed(736, 3.5, 22.3, 1.612, 1.518),
    Pushed(736, 3.5, 47.4, 2.885, 2.976),
    Pushed(736, 5.0, 24.8, 0.489, 0.505),
    Pushed(736, 5.0, 73.5, 1.727, 1.505),
    Pushed(736, 5.0, 138.3, 4.709, 3.701),
    Pushed(736, 8.0, 80.3, 0.521, 0.51),
    Pushed(736, 8.0, 264.8, 1.564, 1.497),
    Pushed(736, 8.0, 396.5, 4.348, 2.601),
)


class ShakingRange(NamedTuple):
    """Where the law may stand in for a bed under shaking, and how well it does.

    Attributes
    ----------
    amplitudes : (float, float)
        Of the piston about its level of rest [m].
    frequencies : (float, float)
        [Hz]
    response_error : float
        Of the amplitude of a pushed piston, relative, at worst.
    loss_error : float
        Of the work that a bed takes in a cycle of a prescribed sine, relative, at worst.
    """

    amplitudes: tuple[float, float]
    frequencies: tuple[float, float]
    response_error: float
    loss_error: float


AMPLITUDES, FREQUENCIES = (0.5, 1.5), (1.0, 8.0)
"""[D] of 368 grains, and [Hz], where a law may stand in for the bed."""
RESPONSE_ERROR = 0.13
"""Greatest of `PUSHED` in this range."""
LOSS_ERROR = 0.13
"""Greatest of prescribed sines of 0.5 to 3 D, of 368 and 736 grains."""


def shaking_range(scene: Scene) -> ShakingRange:
    """The range in which ``annealing-bed`` may stand in for the bed of a scene.

    Amplitudes go with the size of the bed, sqrt(N/368). Smaller ones were not measured.

    Raises
    ------
    InputError
        As `reduced_models.predict`: where nothing is known of the law of a bed.
    """
    parameters_of(scene)  # refuses what is not known
    grains = scene.grains
    unit = math.sqrt(grains.count / 368) * grains.species[0].diameter
    least, greatest = AMPLITUDES
    return ShakingRange((least * unit, greatest * unit), FREQUENCIES, RESPONSE_ERROR, LOSS_ERROR)
