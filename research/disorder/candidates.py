"""Candidates for the effective temperature of a bed, measured in a run, and measures of order.

A temperature should predict the order of the bed. Every candidate is dimensionless: energies are divided by
the energy U_a of a pair at the mean spacing a = sqrt(2/sqrt(3) mean cell area). The result is proportional to
the inverse of the interaction parameter Gamma = (pi rho)^(3/2) a^3 U_a/T = 6.909 U_a/T. A crystal of 4096
dipoles melts near 0.100 in this unit (Gamma = 69; see `research.melting`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from granular.observables.bond_order import psi6
from granular.observables.forces import wall_branches_and_forces
from granular.observables.moduli import dipole_pair_strength
from granular.observables.motion import configurational_temperature, kinetic_temperature, lindemann_parameter
from granular.observables.voronoi import VoronoiCells, voronoi_cells
from granular.run.trajectory import Trajectory
from granular.schema.natural_units import Scales

CANDIDATES: Mapping[str, str] = {
    "kinetic": "kinetic, about the velocity of the bed",
    "local kinetic": "kinetic, about the velocity of the neighbours",
    "configurational": "configurational, mean of (grad U)² over the mean of lap U",
    "piston": "fluctuation and response of the piston",
    "acceleration": "shaking acceleration over the force of a pair",
    "shaking energy": "shaking energy over the energy of a pair",
    "free volume": "free area of a grain over the area of the grain",
    "cell variance": "variance of the cells' area over the square of its mean",
}

ORDERS: Mapping[str, str] = {
    "defects": "fraction of the grains without six neighbours",
    "psi6": "mean of |psi6|",
    "lindemann": "dynamic Lindemann parameter",
}

LAG = 8.0
"""Time of the Lindemann parameter, in sqrt(m a^2/U_a)."""

_HARMONICS = 3
_BENT = 4
_SHIFT = 1e-4
_STILL = 1e-9


def measure_candidates_and_orders(run: Trajectory) -> dict[str, float]:
    """Return candidates and orders of a run of `scene_of_bed`, by the names above.

    Also ``spacing`` [m], ``pair energy`` [J], ``force`` on the piston [N] and ``closest``, the smallest
    distance of two grains [D].
    """
    window = _start_and_end_of_stage(run, "measure")
    data = run.dataset
    times = data["frame_time"].values
    chosen = (times >= window[0]) & (times <= window[1])
    places, velocities = (data[name].values[chosen] for name in ("position", "velocity"))
    heights, forces = (data[name].values[chosen] for name in ("frame_height", "force"))
    cells = [voronoi_cells(item) for item in places]
    areas = [item.area[item.interior] for item in cells]
    area = float(np.mean(np.concatenate(areas)))
    spacing = math.sqrt(2.0 / math.sqrt(3.0) * area)
    energy = _pair_energy_at_spacing(run, spacing)
    masses = run.scene.grains.masses()
    diameter = run.scene.grains.species[0].diameter
    result = {
        "kinetic": np.mean([kinetic_temperature(v, masses) for v in velocities]) / energy,
        "local kinetic": np.mean(
            [local_kinetic_temperature(*p, masses) for p in zip(velocities, cells, strict=True)]
        )
        / energy,
        "configurational": configurational_temperature(run.scene, places, heights, forces) / energy,
        "piston": _temperature_from_piston_force(run, window, places, heights) / energy,
        **_shaking_acceleration_and_energy(run, spacing, energy),
        "free volume": area / (math.sqrt(0.75) * diameter**2) - 1.0,
        "cell variance": np.mean([item.var() for item in areas]) / area**2,
        "defects": np.mean([np.mean(item.sides[item.interior] != 6) for item in cells]),
        "psi6": np.mean([psi6(*item) for item in zip(places, cells, strict=True)]),
        "lindemann": _lindemann_parameter_at_lag(places, times[chosen], masses, spacing, energy),
        "spacing": spacing,
        "pair energy": energy,
        "force": _time_force_and_height_in_window(run, window)[1].mean(),
        "closest": _minimum_grain_distance(places) / diameter,
    }
    return {name: float(value) for name, value in result.items()}


def local_kinetic_temperature(velocities: np.ndarray, cells: VoronoiCells, masses: np.ndarray) -> float:
    """Return (1/2) <m |v_i - V_i|^2/(1 + 1/k_i)> with V_i the mean over the k_i neighbours of i [J].

    Motion shared by neighbours does not count as heat; independent velocities of one temperature give that
    temperature.
    """
    i, j = cells.neighbours.T
    count = len(velocities)
    total = np.zeros_like(velocities)
    np.add.at(total, i, velocities[j])
    np.add.at(total, j, velocities[i])
    number = np.bincount(cells.neighbours.ravel(), minlength=count)
    known = number > 0
    number = np.maximum(number, 1)
    apart = ((velocities - total / number[:, None]) ** 2).sum(axis=1)
    return float(np.mean((0.5 * masses * apart / (1.0 + 1.0 / number))[known]))


def subtract_drive_response(
    time: np.ndarray, values: np.ndarray, frequency: float | None, degree: int = 1
) -> np.ndarray:
    """Return the residual of a record after subtraction of the response to a drive.

    The response is a polynomial of a given degree in time, and a sine at a frequency [Hz], if any.
    """
    since = (time - time.mean()) / max(float(np.ptp(time)), np.finfo(float).tiny)
    columns = [since**k for k in range(degree + 1)]
    for k in range(1, _HARMONICS + 1) if frequency is not None else ():
        phase = 2.0 * np.pi * k * float(frequency or 0.0) * time
        columns += [np.cos(phase), np.sin(phase)]
    table = np.stack(columns, axis=1)
    return np.asarray(values - table @ np.linalg.lstsq(table, values, rcond=None)[0])


def _temperature_from_piston_force(
    run: Trajectory, window: tuple[float, float], places: np.ndarray, heights: np.ndarray
) -> float:
    """Return <dF^2>/(<d^2U/dH^2> + d<F>/dH), which is T in equilibrium [J].

    d<F>/dH = -<d^2U/dH^2> + <dF^2>/T is the fluctuation-response theorem of a piston held at the height H,
    with F = -dU/dH.
    """
    time, force, height = _time_force_and_height_in_window(run, window)
    shaking = run.scene.effects.shaking
    moves = np.ptp(height) > 0.0
    left = subtract_drive_response(
        time, force, None if shaking is None else shaking.frequency, _BENT if moves else 1
    )
    if moves:
        response = float(np.polyfit(height, force, 1)[0])
    else:
        _, stop = _start_and_end_of_stage(run, "after")
        later = _time_force_and_height_in_window(run, (stop - (window[1] - window[0]), stop))
        response = float((later[1].mean() - force.mean()) / (later[2].mean() - height.mean()))
    if np.abs(left).max() < _STILL * np.abs(force).max():
        return 0.0
    stiff = np.mean([_energy_curvature_by_height(run, *item) for item in zip(places, heights, strict=True)])
    return float(np.mean(left**2) / (stiff + response))


def _energy_curvature_by_height(run: Trajectory, places: np.ndarray, height: float) -> float:
    """Return d^2U/dH^2 at fixed positions of the grains [N/m], by differences."""
    step = _SHIFT * run.scene.grains.species[0].diameter
    pushed = [
        float(wall_branches_and_forces(run.scene, places, height + way).forces[:, :, 1].sum())
        for way in (step, -step)
    ]
    # The bottom's energy does not depend on the piston, which pushes the grains down.
    return (pushed[0] - pushed[1]) / (2.0 * step)


def _shaking_acceleration_and_energy(run: Trajectory, spacing: float, energy: float) -> dict[str, float]:
    shaking = run.scene.effects.shaking
    if shaking is None:
        return {"acceleration": 0.0, "shaking energy": 0.0}
    mass = float(run.scene.grains.masses()[0])
    speed = 2.0 * math.pi * shaking.frequency * shaking.amplitude
    force = mass * 2.0 * math.pi * shaking.frequency * speed
    return {
        "acceleration": force / (3.0 * energy / spacing),
        "shaking energy": 0.5 * mass * speed**2 / energy,
    }


def _lindemann_parameter_at_lag(
    places: np.ndarray, times: np.ndarray, masses: np.ndarray, spacing: float, energy: float
) -> float:
    step = float(np.diff(times).mean())
    lag = round(LAG * math.sqrt(float(masses[0]) * spacing**2 / energy) / step)
    return float(lindemann_parameter(places, np.array([max(1, lag)]))[0])


def _pair_energy_at_spacing(run: Trajectory, spacing: float) -> float:
    scales = Scales.from_grains(run.scene.grains)
    return dipole_pair_strength(scales.current * scales.length**2) / spacing**3


def _minimum_grain_distance(places: np.ndarray) -> float:
    from scipy.spatial import cKDTree

    return float(min(cKDTree(item).query(item, 2)[0][:, 1].min() for item in places))


def _start_and_end_of_stage(run: Trajectory, stage: str) -> tuple[float, float]:
    (result,) = [item for item in run.stages if item.name == stage]
    return float(result.start), float(result.end)


def _time_force_and_height_in_window(run: Trajectory, window: tuple[float, float]) -> tuple[Any, Any, Any]:
    """Return time, force on the piston, and its height."""
    data = run.dataset
    time = data["time"].values
    chosen = (time >= window[0]) & (time <= window[1])
    return time[chosen], data["piston_force"].values[chosen], data["piston_height"].values[chosen]
