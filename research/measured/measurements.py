"""Published measurements on beds of repelling magnets, a scene for each, and simulated results."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import numpy as np
from scipy.stats import skew

from granular import Scene, load_scene, simulate
from granular.linear.equilibrium import COARSE_REST, scene_changes_to_end_at_rest
from granular.observables import polygon_fractions, psi6, voronoi_cells
from granular.observables.moduli import dipole_pair_strength, hexagonal_lattice_sum
from research.campaign import Plain

MEASUREMENTS: Plain = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
CELLS = ("deviation", "skewness", "pentagons", "hexagons", "heptagons", "psi6")


def scene_of_measurement(name: str) -> Scene:
    """Return the scene of a measurement."""
    entry = MEASUREMENTS[name]
    return load_scene(entry["scene"]).replace(name=name, **entry["changes"])


def voronoi_and_order_means_of_mixture(ratio: float, beds: int) -> Plain:
    """Return means over beds: relative deviation and skewness of cell areas, polygons, bond order."""
    shares = {"grains.species.big.share": 1.0 - ratio, "grains.species.small.share": ratio}
    scene, rows = scene_of_measurement("tsuchikusa").replace(**shares), []
    for seed in range(1, beds + 1):
        run = simulate(
            scene.replace(**scene_changes_to_end_at_rest(scene, COARSE_REST) | {"arrangement.seed": seed})
        )
        positions = run.dataset["position"].values[-1]
        cells = voronoi_cells(positions)
        area = cells.area[cells.interior]
        polygons = polygon_fractions(cells)[:3]
        rows.append([area.std() / area.mean(), skew(area), *polygons, psi6(positions, cells)])
    return {"ratio": ratio, "beds": beds} | dict(zip(CELLS, np.mean(rows, axis=0).tolist(), strict=True))


def packing_that_lifts_raised_dipole(scene: Scene, height: float) -> float:
    """Return the packing fraction at which a lattice lifts a dipole that is higher by ``height`` [m].

    A pair has the energy C (1 - 4.5 z^2/r^2)/r^3 at the offset z, so the sum of 9 C z/r^5 equals the weight.
    """
    grains = scene.grains
    strength = dipole_pair_strength(grains.magnets_in_species()[0].moment)
    weight = 9.8 * float(grains.masses()[0])
    spacing = (9.0 * strength * height * hexagonal_lattice_sum(5.0) / weight) ** 0.2
    return math.pi / (2.0 * math.sqrt(3.0)) * (grains.species[0].diameter / spacing) ** 2
