"""Figures of one start, from what was written down of its run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from granular.observables import (
    cell_shares,
    hexagon_regularity,
    least_piston_distance,
    psi6,
    relative_fluctuation,
    voronoi_cells,
)
from granular.scene.scene import Scene

Figures = dict[str, Any]
"""Numbers, and lists of numbers, by name."""

DIGITS = 6


def figures_of(record: Mapping[str, Any], scene: Scene) -> Figures:
    """The figures of a bed or a damper.

    Parameters
    ----------
    record : mapping
        Of `bed_record` or `damper_record`.
    scene : Scene

    Returns
    -------
    dict
        Forces in N; lengths in diameters of the first species, their names end in ``_D``; times
        of the damper in s.
    """
    made = _bed_figures(record, scene) if "full" in record else _damper_figures(record, scene)
    made |= {name: record[name] for name in ("steps", "seconds", "ledger")}
    return {name: _rounded(value) for name, value in made.items()}


def _bed_figures(record: Mapping[str, Any], scene: Scene) -> Figures:
    diameter = scene.grains.species[0].diameter
    halves = np.array(record["half_distances"]) / diameter
    full = np.array(record["full"])
    owner = scene.grains.assignment()
    made: Figures = {
        "force": record["down"][-1],
        "half_start_D": halves[0],
        "half_full_D": halves[_place(record["times"], 1.0)],
        "half_end_D": halves[-1] if record["times"][-1] > 2.5 else np.nan,
        "down": record["down"],
        "up": record["up"],
        "packing": _packing(scene, record["full_height"]),
        "least_distance_D": least_piston_distance(full, record["full_height"]) / diameter,
        "nearest_species": int(owner[full[:, 1].argmax()]),
        "small_share": float((owner != 0).mean()),
    }
    made |= _order(np.array(record["start"]), "start") | _order(full, "full")
    return made | _grain_forces(np.array(record["magnitudes"]), full, owner)


def _order(positions: np.ndarray, when: str) -> Figures:
    """Shares of polygons, Psi6, and regularity of the hexagons with its deviation."""
    cells = voronoi_cells(positions)
    shares = cell_shares(cells)
    regularity = hexagon_regularity(cells)
    known = regularity[np.isfinite(regularity)]
    return {
        f"pentagons_{when}": shares.pentagons,
        f"hexagons_{when}": shares.hexagons,
        f"heptagons_{when}": shares.heptagons,
        f"psi6_{when}": psi6(positions, cells),
        f"regularity_{when}": known.mean() if len(known) else np.nan,
        f"regularity_deviation_{when}": known.std() if len(known) else np.nan,
    }


def _grain_forces(magnitudes: np.ndarray, positions: np.ndarray, owner: np.ndarray) -> Figures:
    """Mean magnetic force by species [N], its relative fluctuation, and how far apart they lie.

    Grains with an interior Voronoi cell count, as in [D, 4.3.5].
    """
    inside = voronoi_cells(positions).interior
    if not inside.any():
        return {}
    fluctuation = relative_fluctuation(np.where(inside, magnitudes, np.nan), owner)
    names = ("big", "small")
    made: Figures = {"fluctuation": float(np.nanmean(fluctuation))}
    for place, name in enumerate(names):
        chosen = inside & (owner == place)
        made[f"{name}_force"] = float(magnitudes[chosen].mean()) if chosen.any() else np.nan
    return made | {"force_shares": _deciles(magnitudes[inside])}


def _deciles(values: np.ndarray) -> list[float]:
    """Deciles of the forces over their greatest."""
    return list(np.quantile(values / values.max(), np.linspace(0.1, 0.9, 9)))


def _damper_figures(record: Mapping[str, Any], scene: Scene) -> Figures:
    diameter = scene.grains.species[0].diameter
    same = (
        "period", "damping_ratio", "linear_misfit", "misfit", "alpha", "omega", "g0", "open",
        "times",
    )  # fmt: skip
    return {
        "rest_height_D": record["rest_height"] / diameter,
        "nudge_D": record["nudge"] / diameter,
        "heights_D": np.array(record["heights"]) / diameter,
        **{name: record[name] for name in same},
    }


def _packing(scene: Scene, height: float) -> float:
    area = np.pi / 4.0 * float(np.square(scene.grains.diameters()).sum())
    return area / (scene.cell.width * height)


def _place(times: list[float], wanted: float) -> int:
    return int(np.abs(np.array(times) - wanted).argmin())


def _rounded(value: Any) -> Any:
    if isinstance(value, list | np.ndarray):
        return [_rounded(one) for one in value]
    if isinstance(value, int) or not np.isfinite(value):
        return value if isinstance(value, int) else None
    return float(f"{float(value):.{DIGITS}g}")
