"""Arrangements and trajectories with known results, and brute-force Voronoi cells for comparison."""

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
import xarray

from granular import Scene
from granular.run.trajectory import Trajectory, make_trajectory

MakeRun = Callable[..., Trajectory]

TWO_SPECIES = [
    {"name": "big", "diameter": "6 mm", "share": 0.5},
    {"name": "small", "diameter": "3 mm", "share": 0.5},
]


class Cell(NamedTuple):
    """A Voronoi cell found by brute force: neighbours, ordered corners, and whether it is interior."""

    neighbours: list[int]
    corners: np.ndarray
    interior: bool


def hexagonal(columns: int, rows: int, spacing: float = 1.0) -> np.ndarray:
    """Return a patch of the hexagonal lattice, with rows along x."""
    j, i = np.divmod(np.arange(columns * rows), columns)
    return spacing * np.stack([i + 0.5 * (j % 2), 0.5 * np.sqrt(3.0) * j], axis=1)


def rotated(points: np.ndarray, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


def displacement(points: np.ndarray, core: np.ndarray, burgers: np.ndarray) -> np.ndarray:
    """Return the displacement around an edge dislocation in linear elasticity, with a softened core."""
    angle = np.arctan2(burgers[1], burgers[0])
    x, y = rotated(points - core, -angle).T
    r2, nu, turn = x**2 + y**2 + 0.09, 1.0 / 3.0, 1.0 / (2.0 * np.pi)
    ux = turn * (np.arctan2(y, x) + x * y / (2.0 * (1.0 - nu) * r2))
    uy = -turn * (
        (1.0 - 2.0 * nu) / (4.0 * (1.0 - nu)) * np.log(r2) + (x**2 - y**2) / (4.0 * (1.0 - nu) * r2)
    )
    return rotated(np.stack([ux, uy], axis=1), angle)


def brute_cells(points: np.ndarray) -> list[Cell]:
    """Return the Voronoi cells, from all triples of grains whose circumcircle contains no other grain."""
    triples = np.array(list(itertools.combinations(range(len(points)), 3)))
    a, b, c = (points[triples[:, k]] for k in range(3))
    # The two perpendicular bisectors: (b - a).x = (b.b - a.a)/2 about the point a.
    matrix = np.stack([b - a, c - a], axis=1)
    right = 0.5 * np.stack([((b - a) ** 2).sum(1), ((c - a) ** 2).sum(1)], axis=1)
    centres = np.linalg.solve(matrix, right[:, :, None])[:, :, 0] + a
    radii = np.linalg.norm(centres - a, axis=1)
    gaps = np.linalg.norm(centres[:, None] - points[None], axis=2)
    gaps[np.arange(len(triples))[:, None], triples] = np.inf
    empty = gaps.min(axis=1) > radii
    triples, centres = triples[empty], centres[empty]
    low, high = points.min(axis=0), points.max(axis=0)
    cells = []
    for grain in range(len(points)):
        mine = (triples == grain).any(axis=1)
        neighbours = sorted(set(triples[mine].ravel().tolist()) - {grain})
        corners = centres[mine]
        arm = corners - points[grain]
        corners = corners[np.argsort(np.arctan2(arm[:, 1], arm[:, 0]))]
        closed = len(neighbours) == len(corners)
        boxed = bool(((corners >= low) & (corners <= high)).all())
        cells.append(Cell(neighbours, corners, closed and boxed))
    return cells


def polygon_area(corners: np.ndarray) -> float:
    x, y = (corners - corners[0]).T
    return 0.5 * abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))


def side_lengths(corners: np.ndarray) -> np.ndarray:
    return np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)


@pytest.fixture(scope="session")
def make_run(small_bed: Scene) -> MakeRun:
    """Return a function that makes a trajectory from given frames and records."""

    def make(
        positions: np.ndarray,
        changes: dict[str, object] | None = None,
        heights: np.ndarray | None = None,
        velocities: np.ndarray | None = None,
        forces: np.ndarray | None = None,
        columns: dict[str, np.ndarray] | None = None,
    ) -> Trajectory:
        positions = np.asarray(positions, dtype=float)
        frames, count = positions.shape[:2]
        scene = small_bed.replace(
            **{
                "grains.count": count,
                "arrangement.height": None,
                "cell.width": "60 D",
                "piston.height": "60 D",
                **(changes or {}),
            }
        )
        blank = np.zeros(positions.shape)
        records = columns or {"time": np.arange(float(frames))}
        data = xarray.Dataset(
            {name: ("time", values, {"units": "1"}) for name, values in records.items()}
        ).assign(
            frame_time=("frame", np.arange(float(frames))),
            frame_height=("frame", np.full(frames, 0.36) if heights is None else heights),
            position=(("frame", "grain", "axis"), positions),
            velocity=(("frame", "grain", "axis"), blank if velocities is None else velocities),
            force=(("frame", "grain", "axis"), blank if forces is None else forces),
        )
        outcome = {"figures": {}, "stages": [], "complete": True}
        return make_trajectory(scene, data, {}, outcome, None)

    return make
