"""Where others found the transitions, as Gamma = C (pi rho)^(3/2)/T.

Values that could not be read again in print say so.
"""

from __future__ import annotations

from typing import NamedTuple


class PublishedTransition(NamedTuple):
    """A published melting of a layer of dipoles.

    Attributes
    ----------
    source : str
    hexatic, crystal : float
        Gamma below which the layer is liquid, and hexatic.
    how : str
    """

    source: str
    hexatic: float
    crystal: float
    how: str


PUBLISHED = (
    PublishedTransition(
        "Zahn, Lenke and Maret, Phys. Rev. Lett. 82, 2721 (1999)", 57.5, 60.0,
        "colloids, correlations of bonds and places",
    ),
    PublishedTransition(
        "Dillmann, Maret and Keim, J. Phys.: Condens. Matter 24, 464118 (2012)", 67.3, 70.3,
        "colloids, nine criteria",
    ),
)  # fmt: skip
"""Both from memory: neither paper could be opened here."""
