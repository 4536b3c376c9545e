"""One picture of the bed."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from granular.export.frames import open_run
from granular.observables.frame import frame_at
from granular.render.colourings import colouring_by_name
from granular.render.picture import BedPicture, colour_limits, highest_point_of_bed
from granular.run.trajectory import Trajectory
from granular.shared.errors import InputError
from granular.shared.files import write_atomically
from granular.shared.message_text import quote

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
STILL_DPI = 200


def still(
    run: Trajectory | str | Path, frame: int = -1, *, time: float | None = None, colour: str = "species"
) -> Figure:
    """Picture of the bed at one instant: grains at their true size, walls and piston.

    Grains that have left the cell are not drawn.

    Parameters
    ----------
    run : Trajectory or path
        A run, or its directory.
    frame : int
        Number of the frame, from 0; negative ones count from the end.
    time : float, optional
        Takes the frame nearest to this time [s] instead.
    colour : str
        Quantity that the colours show: a name of `granular.render.colourings.COLOURINGS`. The
        colours end at the 99th percentile of the frame's values.

    Returns
    -------
    matplotlib Figure
        Picture, which `save_picture` writes.

    Raises
    ------
    InputError
        If the run cannot be read, has no such frame, does not reach the time, or the colour is unknown.
    """
    colouring_by_name(colour)
    run = open_run(run)
    chosen = frame_at(run, frame if time is None else _nearest_frame_index(run, time))
    picture = BedPicture(run, colour, colour_limits(colour, [chosen]), highest_point_of_bed(run, [chosen]))
    picture.show_frame(chosen)
    return picture.figure


def _nearest_frame_index(run: Trajectory, time: float) -> int:
    times = run.dataset["frame_time"].values
    if not (math.isfinite(time) and times[0] <= time <= times[-1]):
        raise InputError(
            f"time {time:g} s is not in the run; it has frames from {times[0]:g} to {times[-1]:g} s"
        )
    return int(np.abs(times - time).argmin())


def save_picture(figure: Figure, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write a picture as PNG (200 dots per inch), SVG or PDF, by the ending of the path.

    Without dates in it: the same picture is the same file.

    Parameters
    ----------
    figure : Figure
        Picture, as `still` makes it.
    path : str or Path
        File to write.
    overwrite : bool
        Whether a file that is there may be replaced.

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    InputError
        If the format is another, the file exists and may not be replaced, or it cannot be written.
    """
    import matplotlib as mpl

    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise InputError(
            f"unknown format {quote(path.suffix)} of {path.name}; a still is one of "
            f"{', '.join(FORMATS)}, a movie .mp4 or .gif"
        )
    # Without date and random names the same picture is the same file.
    undated = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    with write_atomically(path, overwrite) as part, mpl.rc_context({"svg.hashsalt": "granular"}):
        figure.savefig(part, dpi=STILL_DPI, metadata=undated[path.suffix.lower()])
    return path
