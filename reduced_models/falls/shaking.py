"""The range in which the law of a bed that orders may stand in for the bed under shaking.

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


class ShakingRange(NamedTuple):
    """The range in which a law may stand in for a shaken bed, and its errors there.

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
"""Greatest of pushed pistons in this range (tests/reduced_models/falls/pushed.py)."""
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
