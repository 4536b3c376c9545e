"""Correlation of defects with uneven forces in space, and their sequence in time.

The force of a grain is its compressive force, the sum of the magnitudes of all forces on the grain. This
force decreases towards the walls, because there are no grains beyond the walls. Each force is therefore
divided by the mean over the grains of the same frame at the same distance from the walls, and defects are
compared with these grains.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from granular.observables.forces import compressive_forces
from granular.observables.voronoi import VoronoiCells, voronoi_cells
from granular.run.trajectory import Trajectory

SHELLS = 5
"""Number of shells: defects, their neighbours, the neighbours of these, ..."""

QUIET = 12
"""Frames before an arrival in which neither the grain nor a neighbour is a defect, and frames after it that
are analysed."""

DEPTHS = np.array([1.5, 2.5, 3.5, 4.5])
"""Edges between classes of distance to the nearest wall, in spacings."""


class ForceField(NamedTuple):
    """Compared quantities of every frame and grain; NaN or False for grains without interior cell.

    Attributes
    ----------
    force : float (f, n)
        Compressive force over the mean at this distance from the walls.
    unevenness : float (f, n)
        Standard deviation of the force over the grain and its neighbours.
    sides : int (f, n)
        Sides of the Voronoi cell; 0 if it is not interior.
    shell : int (f, n)
        Number of neighbour steps to the nearest defect, up to `SHELLS`.
    depth : int (f, n)
        Class of the distance to the nearest wall; -1 if the cell is not interior.
    """

    force: np.ndarray
    unevenness: np.ndarray
    sides: np.ndarray
    shell: np.ndarray
    depth: np.ndarray


def measure_force_field(run: Trajectory, start: float = 0.0) -> ForceField:
    """Return the force field of all frames of a run from a start time on [s]."""
    data = run.dataset
    chosen = data["frame_time"].values >= start
    rows = []
    for places, height in zip(
        data["position"].values[chosen], data["frame_height"].values[chosen], strict=True
    ):
        forces = compressive_forces(run.scene, places, float(height))
        rows.append(_force_field_of_frame(places, forces, run.scene.cell.width, float(height)))
    return ForceField(*(np.array(item) for item in zip(*rows, strict=True)))


def _force_field_of_frame(
    places: np.ndarray, forces: np.ndarray, width: float, height: float
) -> tuple[np.ndarray, ...]:
    cells = voronoi_cells(places)
    spacing = np.sqrt(2.0 / np.sqrt(3.0) * cells.area[cells.interior].mean())
    x, y = places.T
    away = np.min([x, width - x, y, height - y], axis=0) / spacing
    depth = np.searchsorted(DEPTHS, away)
    relative = forces / mean_in_each_class(depth, forces)[depth]
    sides = np.where(cells.interior, cells.sides, 0)
    return (
        np.where(cells.interior, relative, np.nan),
        np.where(cells.interior, _standard_deviation_among_neighbours(relative, cells), np.nan),
        sides,
        neighbour_steps_to_nearest_defect(cells, cells.interior & (cells.sides != 6)),
        np.where(cells.interior, depth, -1),
    )


def mean_in_each_class(places: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the mean of the values in each class."""
    number = np.bincount(places, minlength=len(DEPTHS) + 1)
    total = np.bincount(places, values, minlength=len(DEPTHS) + 1)
    return np.asarray(total / np.maximum(number, 1))


def _standard_deviation_among_neighbours(values: np.ndarray, cells: VoronoiCells) -> np.ndarray:
    """Return the standard deviation over each grain and its neighbours (n,)."""
    i, j = cells.neighbours.T
    count = len(values)
    number = 1.0 + np.bincount(cells.neighbours.ravel(), minlength=count)

    def sum_over_grain_and_neighbours(of: np.ndarray) -> np.ndarray:
        return of + np.bincount(i, of[j], minlength=count) + np.bincount(j, of[i], minlength=count)

    mean = sum_over_grain_and_neighbours(values) / number
    return np.asarray(np.sqrt(np.maximum(sum_over_grain_and_neighbours(values**2) / number - mean**2, 0.0)))


def neighbour_steps_to_nearest_defect(cells: VoronoiCells, defects: np.ndarray) -> np.ndarray:
    """Return the number of neighbour steps from each grain to the nearest defect (n,), up to `SHELLS`."""
    result = np.where(defects, 0, SHELLS)
    i, j = cells.neighbours.T
    for _ in range(SHELLS):
        step = result.copy()
        np.minimum.at(step, i, result[j] + 1)
        np.minimum.at(step, j, result[i] + 1)
        result = step
    return result


def mean_relative_to_other_grains(field: ForceField, values: np.ndarray, chosen: np.ndarray) -> float:
    """Return the mean at chosen grains over the mean at other grains of equal frame and wall distance.

    Parameters
    ----------
    field : ForceField
    values : float (f, n)
    chosen : bool (f, n)
        Chosen grains; grains without interior cell are omitted.

    Returns
    -------
    float
        1 if the choice does not matter; NaN if nothing is chosen.
    """
    classes = len(DEPTHS) + 1
    frame = np.arange(len(values))[:, None] * classes
    known = field.depth >= 0
    index = (frame + field.depth)[known]
    picked = chosen[known]
    most = classes * len(values)
    number = np.bincount(index[picked], minlength=most)
    others = np.bincount(index[~picked], minlength=most)
    total = np.bincount(index[picked], values[known][picked], minlength=most)
    rest = np.bincount(index[~picked], values[known][~picked], minlength=most)
    both = (number > 0) & (others > 0)
    expected = (number * rest / np.maximum(others, 1))[both].sum()
    return float(total[both].sum() / expected) if both.any() else float("nan")


def choose_random_grains_of_same_classes(
    field: ForceField, chosen: np.ndarray, random: np.random.Generator
) -> np.ndarray:
    """Choose random grains, as many in each frame and class of distance from the walls."""
    classes = len(DEPTHS) + 1
    group = np.where(field.depth >= 0, np.arange(len(chosen))[:, None] * classes + field.depth, -1)
    flat, flags = group.ravel(), chosen.ravel()
    mixed = random.permutation(len(flat))
    # Both orders pass through the groups in sequence; within groups the second order is random.
    straight = np.argsort(flat, kind="stable")
    other = mixed[np.argsort(flat[mixed], kind="stable")]
    result = np.zeros_like(flags)
    result[straight] = flags[other]
    return result.reshape(chosen.shape)


def find_defect_arrivals(field: ForceField) -> np.ndarray:
    """Return frames and grains (k, 2) at which a defect arrives in a neighbourhood without defects.

    For `QUIET` frames before, neither the grain nor a neighbour is a defect; its cell is interior during
    these frames and as many afterwards.
    """
    near = field.shell <= 1
    inside = field.depth >= 0
    result = []
    for frame in range(QUIET, len(near) - QUIET):
        window = slice(frame - QUIET, frame + QUIET + 1)
        able = inside[window].all(axis=0) & ~near[frame - QUIET : frame].any(axis=0)
        result += [(frame, int(i)) for i in np.flatnonzero(able & (field.shell[frame] == 0))]
    return np.array(result, dtype=int).reshape(-1, 2)


def mean_around_arrivals(field: ForceField, values: np.ndarray, events: np.ndarray) -> np.ndarray:
    """Return the mean from `QUIET` frames before arrivals to as many after, over calm grains.

    Calm grains have no defect as a neighbour, and the same frame and distance from the walls. Float (2 QUIET
    + 1,), NaN without arrivals.
    """
    calm = field.shell >= 2
    total, number = np.zeros((2, 2 * QUIET + 1))
    for frame, grain in events:
        for k, lag in enumerate(range(-QUIET, QUIET + 1)):
            now = frame + lag
            like = calm[now] & (field.depth[now] == field.depth[now, grain])
            like[grain] = False
            if like.any():
                total[k] += values[now, grain] / values[now, like].mean()
                number[k] += 1
    with np.errstate(invalid="ignore"):
        return np.asarray(total / number)
