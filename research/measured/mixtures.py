"""Mixtures of two sizes of magnets under one load, and the Voronoi cells of their beds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.stats import skew

from granular import Scene, bidisperse, load_scene
from granular.observables import polygon_fractions, psi6, voronoi_cells
from granular.studies.bed_slopes import settled_beds
from research.campaign import Plain

LOAD = 110.0
"""Force up to which the beds of Tsuchikusa et al. were compressed [N] [D, 4.2.2]."""


def mixture(ratio: float = 0.5, seed: int = 1) -> Scene:
    """De Paula's mixture of magnets of 5 and 3 mm under a piston of that weight; ratio of the small ones."""
    grains = bidisperse(0.6, ratio)
    return load_scene("damper").replace(
        **{
            "name": f"mixture-{ratio:g}",
            "grains": grains.grains.to_plain(),
            "cell.width": grains.cell.width,
            "piston.mass": LOAD / 9.8,
            "piston.height": 0.12,
            "effects.drag.coefficient": 1.0,  # beds settle five times as fast as at 0.1 kg/s
            "arrangement.height": 0.115,
            "arrangement.seed": seed,
        }
    )


def cells_of(ratio: float, seeds: int, out: str | Path) -> Plain:
    """Means over beds: deviation of the cells' areas over their mean, skewness, polygons, bond order."""
    rows = []
    for _, positions, _ in settled_beds(mixture(ratio), seeds, out=out, progress=False):
        cells = voronoi_cells(positions)
        area, shares = cells.area[cells.interior], polygon_fractions(cells)
        deviation, skewness = area.std() / area.mean(), skew(area)
        rows.append([deviation, skewness, *shares[:3], psi6(positions, cells), shares.cells])
    names = ("deviation", "skewness", "pentagons", "hexagons", "heptagons", "psi6", "cells")
    return {"ratio": ratio, "beds": seeds} | dict(zip(names, np.mean(rows, axis=0).tolist(), strict=True))
