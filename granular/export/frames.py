"""Iterate over the frames of a run, and select the grains in the cell."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from granular.observables.frame import Frame, frames, present_grain_mask
from granular.run.trajectory import Trajectory, load_trajectory
from granular.shared.array_types import Float, Int
from granular.shared.errors import InputError

BLOCK = 64
"""Number of frames read together, small enough that they fit into memory for any bed."""


def load_run_if_path(run: Trajectory | str | Path) -> Trajectory:
    """Return a given run unchanged, or load the run from a given directory."""
    run = run if isinstance(run, Trajectory) else load_trajectory(run)
    if not run.dataset.sizes["frame"]:
        raise InputError(
            "the run has no frames; simulate a longer time, or reduce the interval output.frames"
        )
    return run


def iterate_frames(
    run: Trajectory, indices: Sequence[int] | None = None, bar: str | None = None
) -> Iterator[Frame]:
    """Yield frames of a run, reading them in blocks."""
    from granular.shared.progress_bars import progress_bar

    chosen = range(run.dataset.sizes["frame"]) if indices is None else indices
    with progress_bar(total=len(chosen), desc=bar, unit="frame", wanted=bool(bar)) as shown:
        for start in range(0, len(chosen), BLOCK):
            for frame in frames(run, chosen[start : start + BLOCK]):
                yield frame
                shown.update()


def present_grain_indices_and_frame(frame: Frame) -> tuple[Int[np.ndarray, "k"], Frame]:
    """Return the indices of the grains in the cell, and the frame with only these grains."""
    present = np.flatnonzero(present_grain_mask(frame.positions))
    fields = ("positions", "velocities", "forces", "species", "diameters", "masses")
    return present, frame._replace(**{name: getattr(frame, name)[present] for name in fields})


def append_zero_z_coordinate(plane: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k 3"]:
    """Append z = 0 to vectors in the plane."""
    return np.column_stack([plane, np.zeros(len(plane))])
