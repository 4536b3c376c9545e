"""Measure forces on many magnets by the toolkit and by magpylib, for the page on magpylib."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial

import magpylib
import numpy as np

from granular import Scene, evaluate, load_scene

DIAMETER, THICKNESS, REMANENCE = 6e-3, 3e-3, 1.3
"""Magnets of the packaged bed [m, m, T]."""
MOMENT = REMANENCE * math.pi / 4.0 * DIAMETER**2 * THICKNESS / (4e-7 * math.pi)
"""Magnetic moment [A m^2]."""
SPACING = 1.5 * DIAMETER
"""Distance of neighbours before the displacements [m]."""
EPS = 1e-6
"""Step of magpylib's difference quotients [m]; the default 1e-5 is coarse for magnets of 6 mm."""


def positions(count: int) -> np.ndarray:
    """Positions (n, 2) [m] near the sites of a square grid."""
    side = math.ceil(math.sqrt(count))
    sites = np.stack(np.divmod(np.arange(count), side), axis=1) + 1.0
    random = np.random.default_rng(count)
    return SPACING * (sites + random.uniform(-0.1, 0.1, sites.shape))


def free_magnets(count: int, magnets: str = "dipoles") -> Scene:
    """Scene of free magnets, without walls and weight."""
    size = SPACING * (math.ceil(math.sqrt(count)) + 2.0)
    changes = {"grains.count": count, "grains.magnets": magnets, "pairs.method": "direct"}
    room = {"cell.width": size, "piston.height": size, "arrangement.height": 0.9 * size}
    absent = dict.fromkeys(("effects.walls", "effects.gravity", "effects.drag"))
    return load_scene("bed").replace(**changes, **room, **absent)


def magpylib_forces(places: np.ndarray, discs: bool, meshing: int | None = None) -> np.ndarray:
    """Forces (n, 2) [N] by `magpylib.getFT`, without those of a magnet on itself."""
    points = np.column_stack([places, np.zeros(len(places))])
    if discs:
        size, polarization = (DIAMETER, THICKNESS), (0.0, 0.0, REMANENCE)
        magnets = [
            magpylib.magnet.Cylinder(position=point, dimension=size, polarization=polarization)
            for point in points
        ]
    else:
        magnets = [magpylib.misc.Dipole(position=point, moment=(0.0, 0.0, MOMENT)) for point in points]
    with np.errstate(invalid="ignore"):  # a dipole at its own place
        force, _ = magpylib.getFT(magnets, magnets, meshing=meshing, eps=EPS, squeeze=False)
    pairs = force[:, 0]
    pairs[np.arange(len(places)), np.arange(len(places))] = 0.0
    return np.asarray(pairs.sum(axis=0)[:, :2])


def seconds(job: Callable[[], object], most: float = 2.0) -> float:
    """Minimum time of a call [s], over calls that take about two seconds together, after a first one."""
    job()
    times: list[float] = []
    while sum(times) < most and len(times) < 50:
        begin = time.perf_counter()
        job()
        times.append(time.perf_counter() - begin)
    return min(times)


COUNTS, MAGPYLIB_MOST = (10, 30, 100, 300, 1000, 3000, 10_000), 300
"""Numbers of dipoles to time, and the maximum for magpylib."""


def times_and_deviations() -> list[tuple[int, float, float, float]]:
    """Number of dipoles, times of getFT and of evaluate [s], deviation over the maximum force."""
    rows = []
    for count in COUNTS:
        places, bed = positions(count), free_magnets(count)
        ours = evaluate(bed, places).force
        theirs, deviation = math.nan, math.nan
        if count <= MAGPYLIB_MOST:
            off = magpylib_forces(places, discs=False) - ours
            deviation = float(np.abs(off).max() / np.abs(ours).max())
            theirs = seconds(partial(magpylib_forces, places, discs=False))
        rows.append((count, theirs, seconds(partial(evaluate, bed, places)), deviation))
    return rows


def disc_deviations(cells: tuple[int, ...] = (20, 100, 500, 2500)) -> list[tuple[int, float]]:
    """Deviation of getFT on ten discs from the law of discs, over the maximum force, by number of cells."""
    places = positions(10)
    ours = evaluate(free_magnets(10, "cylinders"), places).force
    return [
        (
            one,
            float(np.abs(magpylib_forces(places, discs=True, meshing=one) - ours).max() / np.abs(ours).max()),
        )
        for one in cells
    ]
