"""Computation of the figures of a random start from the stored record of its run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from granular.observables import (
    area_fraction_profile,
    axial_order_parameter,
    compressive_forces,
    dip_test,
    hexagon_regularity,
    polygon_fractions,
    psi6,
    radial_distribution,
    relative_force_fluctuation,
    spatial_correlation,
    voronoi_cells,
)
from granular.scene.scene import Scene
from research.published.swing import oscillation_figures

Figures = dict[str, Any]
"""Numbers, and lists of numbers, by name."""

DIGITS = 6

COURSE_TIMES = np.linspace(0.0, 3.0, 61)
"""Times of the curve of the mean distance, from the start of the compression [T]."""
STROKES = 51
"""Number of stored points of the force curve, on the way down and up."""
STRIPS = 10
"""Number of strips of the profile below the piston."""
SMOOTHED = 9
"""Number of samples over which a curve is smoothed to measure its roughness."""


def figures_of_record(record: Mapping[str, Any], scene: Scene) -> Figures:
    """Return the figures of a bed or a damper.

    Parameters
    ----------
    record : mapping
        Of `measure_bed_states_and_curves`, `measure_state_at_pressing_force` or
        `measure_fall_equilibrium_and_oscillation`.
    scene : Scene

    Returns
    -------
    dict
        Forces in N; lengths in diameters of the first species, their names end in ``_D``; times
        of the damper in s.
    """
    if "full" in record:
        made = _figures_of_bed_cycle(record, scene)
    elif "pressed" in record:
        made = _figures_of_pressed_bed(record, scene)
    else:
        made = oscillation_figures(record, scene)
    made |= {name: record[name] for name in ("steps", "seconds", "ledger")}
    return {name: _round_to_stored_digits(value) for name, value in made.items()}


def _figures_of_bed_cycle(record: Mapping[str, Any], scene: Scene) -> Figures:
    start, full = (np.array(record[name]) for name in ("start", "full"))
    made = _distance_figures(record, scene) | _force_curve_figures(record)
    made |= {
        "force": record["down"][-1],
        "packing": _packing_fraction_at_height(scene, record["full_height"]),
        "nearest_species": int(scene.grains.species_indices()[full[:, 1].argmax()]),
        "small_share": float((scene.grains.species_indices() != 0).mean()),
        "bottom_start": record["walls"].get("bottom_force", [np.nan])[0],
        "weight": 9.8 * float(scene.grains.masses().sum()),
    }
    made |= _order_figures(start, "start") | _order_figures(full, "full")
    made |= _area_fraction_profile_figures(start, record["start_height"], scene, "start")
    made |= _area_fraction_profile_figures(full, record["full_height"], scene, "full")
    made |= _grain_force_figures(record, scene) | _radial_distribution_shell_count(full)
    return made


def _distance_figures(record: Mapping[str, Any], scene: Scene) -> Figures:
    diameter = scene.grains.species[0].diameter
    halves = np.array(record["half_distances"]) / diameter
    times = np.array(record["times"])
    start, full = float(halves[0]), float(halves[int(np.abs(times - 1.0).argmin())])
    end = float(halves[-1]) if times[-1] > 2.5 else np.nan
    near = np.array(record["piston_distances"]) / diameter
    return {
        "half_start_D": start,
        "half_full_D": full,
        "half_end_D": end,
        "hysteresis_D": start - end,
        "start_over_full": start / full,
        "end_over_full": end / full,
        "hysteresis_over_full": (start - end) / full,
        "least_distance_D": near[int(np.abs(times - 1.0).argmin())],
        "least_distance_half_way_D": near[int(np.abs(times - 0.5).argmin())],
        "lowest_start_D": float(np.array(record["start"])[:, 1].min()) / diameter,
        "half_course_D": np.interp(COURSE_TIMES, times, halves) if times[-1] > 2.5 else [],
    }


def _force_curve_figures(record: Mapping[str, Any]) -> Figures:
    """Return the force on the way down and up, and its roughness, over its maximum."""
    made: Figures = {}
    for way in ("down", "up"):
        trajectory = np.array(record[way])
        if len(trajectory):
            even = np.linspace(0, len(trajectory) - 1, STROKES).round().astype(int)
            made[way] = trajectory[even]
            smooth = np.convolve(trajectory, np.full(SMOOTHED, 1.0 / SMOOTHED), mode="valid")
            rest = trajectory[SMOOTHED // 2 : -(SMOOTHED // 2)] - smooth
            made[f"roughness_{way}"] = float(np.sqrt(np.mean(rest**2)) / trajectory.max())
    return made


def _order_figures(positions: np.ndarray, when: str) -> Figures:
    """Return fractions of polygons, Psi6, and regularity of the hexagons with its deviation."""
    cells = voronoi_cells(positions)
    fractions = polygon_fractions(cells)
    regularity = hexagon_regularity(cells)
    known = regularity[np.isfinite(regularity)]
    return {
        f"pentagons_{when}": fractions.pentagons,
        f"hexagons_{when}": fractions.hexagons,
        f"heptagons_{when}": fractions.heptagons,
        f"psi6_{when}": psi6(positions, cells),
        f"regularity_{when}": known.mean() if len(known) else np.nan,
        f"regularity_deviation_{when}": known.std() if len(known) else np.nan,
    }


def _area_fraction_profile_figures(positions: np.ndarray, height: float, scene: Scene, when: str) -> Figures:
    """Return the local area fraction from the bottom to the piston."""
    edges = np.linspace(0.0, height, STRIPS + 1)
    diameters = scene.grains.diameters()
    return {f"profile_{when}": area_fraction_profile(positions, diameters, scene.cell.width, edges)}


def _grain_force_figures(record: Mapping[str, Any], scene: Scene) -> Figures:
    """Return forces on the grains with an interior Voronoi cell, as in [D, 4.3.5].

    Compressive forces: mean by species, the dip test of all together, the fraction of the small
    grains below the median of all. Resulting forces: mean fluctuation, and axial order parameter of their
    directions. Along chains, the compressive forces of neighbours would be similar: their correlation, over
    the mean of the species.
    """
    positions, owner = np.array(record["full"]), scene.grains.species_indices()
    inside = voronoi_cells(positions).interior
    if inside.sum() < 10:
        return {}
    integer = np.array(record["forces"])
    if scene.effects.gravity is not None:
        integer[:, 1] += scene.effects.gravity.acceleration * scene.grains.masses()
    sizes = np.linalg.norm(integer, axis=1)
    pressed = compressive_forces(scene, positions, record["full_height"])
    test = dip_test(pressed[inside])
    median = float(np.median(pressed[inside]))
    directions = axial_order_parameter(integer[inside])
    relative = pressed.copy()
    made: Figures = {
        "dip": test.dip,
        "dip_p": test.p,
        "fluctuation": float(np.nanmean(relative_force_fluctuation(np.where(inside, sizes, np.nan), owner))),
        "polar_order": directions.polar,
        "axial_order": directions.axial,
        "axial_p": directions.axial_p,
        "modes": np.histogram(pressed[inside] / pressed[inside].max(), 25, (0.0, 1.0))[0],
    }
    for index, name in enumerate(("big", "small")):
        chosen = inside & (owner == index)
        if chosen.any():
            relative[owner == index] /= pressed[chosen].mean()
            made[f"{name}_compression"] = float(pressed[chosen].mean())
            made[f"{name}_force"] = float(sizes[chosen].mean())
            made[f"{name}_below_median"] = float((pressed[chosen] < median).mean())
    made["neighbours_alike"] = _correlation_between_neighbours(positions, np.where(inside, relative, np.nan))
    return made


def _correlation_between_neighbours(positions: np.ndarray, values: np.ndarray) -> float:
    """Return the correlation of a value between neighbours: grains up to 1.3 mean spacings apart."""
    points = positions[np.isfinite(values)]
    spacing = float(np.sqrt(np.ptp(points, axis=0).prod() / len(points)))
    result = spatial_correlation(positions, values, np.array([0.0, 1.3 * spacing]))
    return float(result.values[0])


def _radial_distribution_shell_count(positions: np.ndarray) -> Figures:
    """Return the number of shells of g(r): maxima above 1.1 between values below 0.95."""
    result = radial_distribution(positions)
    smooth = np.convolve(result.values, np.full(3, 1.0 / 3.0), mode="same")
    shells, low = 0, True
    for value in smooth:
        shells += low and value > 1.1
        low = value < 0.95 or (low and value <= 1.1)
    return {"shells": int(shells)}


def _figures_of_pressed_bed(record: Mapping[str, Any], scene: Scene) -> Figures:
    positions = np.array(record["pressed"])
    diameter = scene.grains.species[0].diameter
    return {
        "force": record["pressed_force"],
        "greatest": record["greatest"],
        "height_D": record["pressed_height"] / diameter,
        "packing": _packing_fraction_at_height(scene, record["pressed_height"]),
        **_order_figures(positions, "pressed"),
    }


def _packing_fraction_at_height(scene: Scene, height: float) -> float:
    area = np.pi / 4.0 * float(np.square(scene.grains.diameters()).sum())
    return area / (scene.cell.width * height)


def _round_to_stored_digits(value: Any) -> Any:
    if isinstance(value, list | np.ndarray):
        return [_round_to_stored_digits(item) for item in value]
    if isinstance(value, int | np.integer):
        return int(value)
    return float(f"{float(value):.{DIGITS}g}") if np.isfinite(value) else None
