"""What is measured in a bed: structure, forces, energies and the answer to a drive.

Every observable has two layers. Functions of plain arrays (positions, diameters, forces) return
arrays or named tuples; functions of a `granular.Trajectory`, whose names end in ``_series`` or
``_of_run``, return labelled xarray objects with units. Grains whose position is NaN have left the
cell and count nowhere. `granular.observables.plots` draws the results.
"""

from __future__ import annotations

import importlib
from typing import Any

_NAMES = {
    "area_profile": ("area_fraction_profile", "area_profile_series"),
    "biexponential": ("BiexponentialFit", "biexponential_fit"),
    "orientation": ("BondCorrelation", "bond_correlation", "bond_correlation_of_run"),
    "correlation": ("Correlation", "order_correlation_of_run", "pearson_correlation"),
    "defects": ("Dislocations", "defect_series", "disclination_charges", "dislocations"),
    "distance": ("mean_pair_distance", "pair_distance_series", "source_pair_distance"),
    "force_distribution": (
        "Histogram", "force_distribution_of_run", "knuth_bins", "knuth_histogram",
    ),
    "fluctuation": ("fluctuation_series", "relative_fluctuation"),
    "forces": (
        "force_magnitudes", "grain_forces", "interaction_forces", "piston_force", "wall_forces",
    ),
    "hysteresis": ("Cycle", "cycle_bounds", "hysteresis_energy", "hysteresis_of_run"),
    "packing": ("packing_fraction", "packing_series"),
    "piston_distance": ("least_piston_distance", "piston_distance_series"),
    "bond_order": ("global_psi6", "local_psi6", "psi6", "psi6_series"),
    "radial": (
        "RadialDistribution", "radial_distribution", "radial_distribution_of_run",
    ),
    "regularity": ("hexagon_regularity", "regularity_series"),
    "response": ("FrequencyResponse", "frequency_response", "response_of_run"),
    "hexatic": ("hexatic_susceptibility", "susceptibility_of_run"),
    "temperature": ("kinetic_temperature", "temperature_series"),
    "voronoi": (
        "CellShares", "VoronoiCells", "cell_polygons", "cell_shares", "share_series",
        "voronoi_cells",
    ),
}  # fmt: skip
_HOMES = {name: home for home, names in _NAMES.items() for name in names}

__all__ = sorted(_HOMES)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    # Names are looked up when they are used, so that importing the package costs next to nothing.
    if name not in _HOMES:
        raise AttributeError(f"module 'granular.observables' has no attribute {name!r}")
    return getattr(importlib.import_module(f"granular.observables.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(_HOMES)
