"""The bed between its frames, at the moments of a movie's pictures."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence

import numpy as np

from granular.export.frames import BedFrame, iterate_frames
from granular.run.trajectory import Trajectory
from granular.schema.apparatus import Cell

FARTHEST = 0.25
"""How far [diameters] a grain's path may bend away from a straight line between two frames."""


def movie_times(times: np.ndarray, speed: float, fps: float) -> np.ndarray:
    """Return the times [s] of the pictures of a movie over frames (m,) at such times [s]."""
    start, length = float(times[0]), float(times[-1] - times[0])
    return start + speed / fps * np.arange(int(length * fps / speed * (1.0 + 1e-12)) + 1)


def interpolate_bed(
    run: Trajectory, numbers: Sequence[int], times: np.ndarray, bar: str | None = None
) -> Iterator[BedFrame]:
    """Bed at increasing times [s] (n,) within some frames of a run.

    Grains go between two frames on the cubic paths that have their positions and velocities there,
    forces and velocities change evenly; a grain that is not in both frames is left out. The piston
    is where it was recorded. With ``bar``, a progress bar of that name is shown.

    Warns
    -----
    UserWarning
        If frames lie so far apart that the paths between them are guesses.
    """
    frames = iterate_frames(run, numbers, bar)
    before = after = next(frames)
    heights = _PistonHeights(run)
    bent = 0.0
    for time in times:
        while after.time < time:
            following = next(frames, None)
            if following is None:
                break
            before, after = after, following
            bent = max(bent, _path_curvature(before, after))
        yield _interpolate_between(before, after, float(time), heights, run.scene.cell)
    if bent > FARTHEST * run.scene.grains.diameters().max(initial=0.0):
        warnings.warn(
            f"between two frames a grain leaves the straight line by {1e3 * bent:.2g} mm, so the "
            "paths that the movie shows there are guesses; lower output.frames for true ones",
            stacklevel=2,
        )


class _PistonHeights:
    """The recorded height of the piston at any time."""

    def __init__(self, run: Trajectory) -> None:
        data = run.dataset
        self.known = "piston_height" in data and data.sizes["time"] > 0
        if self.known:
            self._times = data["time"].values
            self._heights = data["piston_height"].values

    def at(self, time: float) -> float:
        return float(np.interp(time, self._times, self._heights))


def _common_grains(before: BedFrame, after: BedFrame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Grains that are in both frames, and their indices in each."""
    return np.intersect1d(before.grains, after.grains, return_indices=True)


def _path_curvature(before: BedFrame, after: BedFrame) -> float:
    """Most by which a cubic path is off the straight line midway [m]."""
    _, first, second = _common_grains(before, after)
    change = before.velocity[first] - after.velocity[second]
    off = (after.time - before.time) / 8.0 * np.hypot(*change.T)
    return float(off.max(initial=0.0))


def _interpolate_between(
    before: BedFrame, after: BedFrame, time: float, heights: _PistonHeights, cell: Cell
) -> BedFrame:
    duration = after.time - before.time
    fraction = min(max((time - before.time) / duration, 0.0), 1.0) if duration > 0.0 else 0.0
    if fraction in (0.0, 1.0):
        frame = after if fraction else before
        return frame._replace(time=time) if not heights.known else _host_displacement(frame, time, heights)
    grains, first, second = _common_grains(before, after)

    def evenly(name: str) -> np.ndarray:
        ends = getattr(before, name)[first], getattr(after, name)[second]
        return (1.0 - fraction) * ends[0] + fraction * ends[1]

    start = before.position[first]
    end = start + cell.nearest_image_displacements(after.position[second] - start)
    leaving, arriving = duration * before.velocity[first], duration * after.velocity[second]
    rest = 1.0 - fraction
    position = (
        rest * rest * (1.0 + 2.0 * fraction) * start
        + fraction * fraction * (3.0 - 2.0 * fraction) * end
        + fraction * rest * (rest * leaving - fraction * arriving)
    )
    frame = BedFrame(
        before.number,
        time,
        before.height,
        grains,
        cell.wrap_positions(position),
        evenly("velocity"),
        evenly("force"),
        evenly("interaction"),
    )
    return _host_displacement(frame, time, heights) if heights.known else frame


def _host_displacement(frame: BedFrame, time: float, heights: _PistonHeights) -> BedFrame:
    return frame._replace(time=time, height=heights.at(time))
