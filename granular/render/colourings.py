"""Colourings of a picture, in one table.

Continuous colours are matplotlib's perceptually uniform maps; the discrete ones are distinguished
by colour-blind eyes too: the species after Okabe and Ito (https://jfly.uni-koeln.de/color/), the
numbers of sides between orange and purple.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from granular.observables.catalogue import grain_compressive_force, grain_pressure, interior_force_fluctuation
from granular.observables.forces import interaction_forces
from granular.observables.frame import Frame
from granular.observables.voronoi import hexagon_regularity, voronoi_cells
from granular.scene.scene import Scene
from granular.shared.errors import InputError
from granular.shared.message_text import unknown_word_message
from granular.shared.plotting import SIDES

SPECIES = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442")


class Colouring(NamedTuple):
    """Quantity that the colours show."""

    label: str  # title of bar or legend, with the unit
    values: Callable[[Frame], np.ndarray]  # (n,), in that unit; NaN: none; of classes the index
    map: str = ""  # of matplotlib; empty: classes
    needs_cells: bool = False  # values follow from the Voronoi cells, which are drawn
    on_cells: bool = False  # cells are coloured, grains are dark discs
    lower: float | None = 0.0  # end of the colours; None: 1st percentile
    upper: float | None = None  # None: 99th percentile


def _voronoi_side_counts(frame: Frame) -> np.ndarray:
    cells = voronoi_cells(frame.positions)
    return np.where(cells.interior, np.clip(cells.sides, 4, 8) - 4.0, np.nan)


COLOURINGS: Mapping[str, Colouring] = {
    "species": Colouring("species", lambda frame: frame.species.astype(float)),
    "speed": Colouring(
        "speed [mm/s]", lambda frame: 1e3 * np.linalg.norm(frame.velocities, axis=1), "viridis"
    ),
    "force": Colouring(
        "force of grains and walls [N]",
        lambda frame: np.linalg.norm(interaction_forces(frame), axis=1),
        "inferno",
    ),
    "compression": Colouring("compressive force [N]", grain_compressive_force, "inferno", lower=None),
    "pressure": Colouring(
        "pressure of the grain [N/m] (white: rim)",
        grain_pressure,
        "inferno",
        needs_cells=True,
        on_cells=True,
        lower=None,
    ),
    "sides": Colouring("sides of the Voronoi cell", _voronoi_side_counts, needs_cells=True, on_cells=True),
    "regularity": Colouring(
        "regularity of the hexagons (white: others)",
        lambda frame: hexagon_regularity(voronoi_cells(frame.positions)),
        "viridis",
        needs_cells=True,
        on_cells=True,
        lower=None,
        upper=1.0,
    ),
    "fluctuation": Colouring(
        "relative fluctuation of the force (white: rim)",
        interior_force_fluctuation,
        "cividis",
        needs_cells=True,
    ),
}
"""The colourings by name.

``species``; ``speed``; ``force``: magnitude of the resulting force of grains and walls;
``compression``: sum of the magnitudes of the single ones; ``pressure`` of the grains with an
interior cell, by their virials; ``sides``: number of sides of the interior Voronoi cells;
``regularity`` of the hexagonal ones [D, eq. 4.25]; ``fluctuation``: |F_k - mean|/mean of the
resulting force within the species, of the grains with an interior cell [D, eq. 4.35]. A cell is
interior if it lies in the box of the outermost centres [D, 4.2.4].
"""


def colouring_by_name(name: str) -> Colouring:
    """Find a colouring by its name."""
    if name not in COLOURINGS:
        raise InputError(unknown_word_message(name, tuple(COLOURINGS), "colour"))
    return COLOURINGS[name]


def colour_classes(name: str, scene: Scene) -> dict[str, str]:
    """Names and colours of the classes of a colouring."""
    if name == "sides":
        return SIDES
    if name != "species":
        return {}
    names = [f"{specy.name}, {1e3 * specy.diameter:g} mm" for specy in scene.grains.species]
    return {name: SPECIES[k % len(SPECIES)] for k, name in enumerate(names)}
