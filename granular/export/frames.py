"""The frames of a run, one after the other, with the grains that are in the cell."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.run.trajectory import Trajectory, load_trajectory
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float, Int

BLOCK = 64
"""Frames that are read together: few enough to fit into memory with any bed."""


class BedFrame(NamedTuple):
    """The bed at one instant, in SI: the k grains that are in the cell."""

    number: int  # index in the run
    time: float  # [s]
    height: float | None  # of the piston [m]; None without one
    grains: Int[np.ndarray, "k"]  # index of each grain in the scene
    position: Float[np.ndarray, "k 2"]  # [m], in the cell if it is periodic
    velocity: Float[np.ndarray, "k 2"]  # [m/s]
    force: Float[np.ndarray, "k 2"]  # magnetic, weight and contact [N]
    interaction: Float[np.ndarray, "k 2"]  # of grains and walls alone [N]


def open_run(run: Trajectory | str | Path) -> Trajectory:
    """Return a run as it is, or load the run in a directory."""
    run = run if isinstance(run, Trajectory) else load_trajectory(run)
    if not run.dataset.sizes["frame"]:
        raise InputError("the run has no frames; run it for longer, or lower output.frames")
    return run


def iterate_frames(
    run: Trajectory, indices: Sequence[int] | None = None, bar: str | None = None
) -> Iterator[BedFrame]:
    """Yield frames of a run, some of which are in memory at a time."""
    from granular.shared.progress_bars import progress_bar

    chosen = range(run.dataset.sizes["frame"]) if indices is None else indices
    with progress_bar(total=len(chosen), desc=bar, unit="frame", wanted=bool(bar)) as shown:
        for start in range(0, len(chosen), BLOCK):
            for frame in _read_frame_block(run, list(chosen[start : start + BLOCK])):
                yield frame
                shown.update()


def _read_frame_block(run: Trajectory, indices: list[int]) -> Iterator[BedFrame]:
    from granular.observables.forces import interaction_forces
    from granular.observables.frame import frames

    has_piston = run.scene.piston is not None
    part = dataclasses.replace(run, dataset=run.dataset.isel(frame=indices).load())
    for number, frame in zip(indices, frames(part), strict=True):
        grains = np.flatnonzero(np.isfinite(frame.positions).all(axis=1))
        fields = frame.positions, frame.velocities, frame.forces, interaction_forces(frame)
        height = frame.piston_height if has_piston else None
        yield BedFrame(int(number), frame.time, height, grains, *(field[grains] for field in fields))


def planar_to_spatial(plane: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k 3"]:
    """Append z = 0 to vectors in the plane."""
    return np.column_stack([plane, np.zeros(len(plane))])
