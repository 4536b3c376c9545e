"""Observables by name: those of the package, a user's own, or of an installed distribution."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from granular.observables.bond_order import psi6
from granular.observables.checks import present
from granular.observables.defects import defect_numbers
from granular.observables.forces import (
    compressive_forces,
    grain_pressures,
    grain_stresses,
    interaction_forces,
    relative_fluctuation,
)
from granular.observables.frame import (
    Frame,
    Value,
    observable,
    require_piston,
    species_names,
)
from granular.observables.packing import (
    least_piston_distance,
    mean_pair_distance,
    packing_fraction,
)
from granular.observables.temperature import fluctuation_energies, kinetic_temperature
from granular.observables.voronoi import hexagon_regularity, polygon_fractions, voronoi_cells


@observable("m", "mean distance of two grains")
def mean_distance(frame: Frame) -> float:
    return mean_pair_distance(frame.positions)


@observable("m", "distance of the piston from the grain next to it")
def piston_distance(frame: Frame) -> float:
    return least_piston_distance(frame.positions, frame.piston_height)


@observable("m", "least distance of a grain's centre from the piston")
def species_piston_distance(frame: Frame) -> dict[str, float]:
    require_piston(frame.scene)
    return {
        name: least_piston_distance(frame.positions[frame.species == k], frame.piston_height)
        for k, name in enumerate(species_names(frame.scene))
    }


@observable("1", "packing fraction below the piston, or of a periodic cell")
def packing(frame: Frame) -> float:
    here = present(frame.positions)
    height = frame.scene.cell.height or frame.piston_height
    return float(packing_fraction(frame.diameters[here], frame.scene.cell.width, height))


@observable("1", "mean of |psi_6| over the grains")
def hexatic_order(frame: Frame) -> float:
    return psi6(frame.positions)


@observable("1", "fraction of the cells")
def polygons(frame: Frame) -> dict[str, float]:
    return polygon_fractions(voronoi_cells(frame.positions)).by_name


@observable("1", "number of interior Voronoi cells")
def interior_cells(frame: Frame) -> float:
    return float(voronoi_cells(frame.positions).interior.sum())


@observable("1", "regularity of the hexagons")
def regularity(frame: Frame) -> dict[str, float]:
    values = hexagon_regularity(voronoi_cells(frame.positions))
    values = values[np.isfinite(values)]
    if not len(values):
        return {"mean": np.nan, "deviation": np.nan}
    return {"mean": float(values.mean()), "deviation": float(values.std())}


@observable("1", "number of defects")
def defects(frame: Frame) -> dict[str, float]:
    return defect_numbers(voronoi_cells(frame.positions))


@observable("J", "kinetic temperature of the bed")
def temperature(frame: Frame) -> float:
    return kinetic_temperature(frame.velocities, frame.masses)


@observable("J", "kinetic temperature of the species")
def species_temperature(frame: Frame) -> dict[str, float]:
    energies = fluctuation_energies(frame.velocities, frame.masses)
    means = {}
    for k, name in enumerate(species_names(frame.scene)):
        known = energies[(frame.species == k) & np.isfinite(energies)]
        means[name] = float(known.mean()) if len(known) else np.nan
    return means


@observable("N", "force of grains and walls on the grain")
def interaction_force(frame: Frame) -> np.ndarray:
    return interaction_forces(frame)


@observable("1", "relative fluctuation of the force on the grain")
def force_fluctuation(frame: Frame) -> np.ndarray:
    """As in [D, Fig. 4.24] of the grains with an interior cell; the others are NaN here."""
    sizes = np.linalg.norm(interaction_forces(frame), axis=1)
    inner = voronoi_cells(frame.positions).interior
    return relative_fluctuation(np.where(inner, sizes, np.nan), frame.species)


@observable("N", "compressive force on the grain")
def compressive_force(frame: Frame) -> np.ndarray:
    return compressive_forces(frame.scene, frame.positions, frame.piston_height)


@observable("N/m", "stress of the grain, positive for compression")
def grain_stress(frame: Frame) -> np.ndarray:
    return grain_stresses(frame.scene, frame.positions, frame.piston_height)


@observable("N/m", "pressure of the grain")
def grain_pressure(frame: Frame) -> np.ndarray:
    return grain_pressures(frame.scene, frame.positions, frame.piston_height)


OBSERVABLES: Mapping[str, Callable[[Frame], Value]] = {
    function.__name__: function
    for function in (
        mean_distance, piston_distance, species_piston_distance, packing, hexatic_order, polygons,
        interior_cells, regularity, defects, temperature, species_temperature, interaction_force,
        force_fluctuation, compressive_force, grain_stress, grain_pressure,
    )
}  # fmt: skip
"""The package's observables by name."""
