"""The maps under sliders: a page that computes a damper's figures and its swing in the browser."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from granular.scene.beds import REFERENCE_COUNT
from granular.shared.live import LivePage
from reduced_models.designs.candidate import (
    ASPECT,
    DIAMETER,
    EXPONENT,
    GRAVITY,
    HIGHEST,
    LOWEST,
    REFERENCE_MASS,
    REFERENCE_REST,
)

TEMPLATE = Path(__file__).with_name("view.html")
HEIGHT = 560


class Terms(NamedTuple):
    """A map as sums of products of Legendre polynomials.

    Attributes
    ----------
    coefficients : float64 (terms,)
    powers : tuple of (int, int, int, int)
        Degree in each coordinate, of each term.
    error : float
        Of the map.
    """

    coefficients: np.ndarray
    powers: tuple[tuple[int, ...], ...]
    error: float


def view_of(maps: Mapping[str, Terms]) -> LivePage:
    """The page of some maps, by the names of their figures."""
    surfaces = {
        name: one._asdict() | {"coefficients": one.coefficients.tolist()}
        for name, one in maps.items()
    }
    data = {
        "surfaces": surfaces,
        "lowest": LOWEST,
        "highest": HIGHEST,
        "aspect": ASPECT,
        "diameter": DIAMETER,
        "exponent": EXPONENT,
        "gravity": GRAVITY,
        "mass": REFERENCE_MASS,
        "rest": REFERENCE_REST,
        "count": REFERENCE_COUNT,
    }
    return LivePage.of(TEMPLATE, "The damper by its maps", data, HEIGHT)
