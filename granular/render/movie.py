"""Movies of a bed."""

from __future__ import annotations

import contextlib
import itertools
import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from granular.export.frames import iterate_frames, load_run_if_path
from granular.observables.forces import acceleration_by_weight_and_shaking, interaction_forces
from granular.observables.frame import Frame
from granular.render.picture import (
    DPI,
    LEFT,
    RIGHT,
    BedPicture,
    choose_colour_limits,
    colouring_by_name,
    highest_point_of_bed,
)
from granular.run.trajectory import Trajectory
from granular.shared.array_types import Float
from granular.shared.errors import InputError, import_extra, quote
from granular.shared.files import check_output_file, write_atomically
from granular.shared.stop_signals import StopRequest, defer_stop_signals

WIDTH = 960
"""Maximum and default width of a movie [pixels]."""
MINIMUM_WIDTH = 760
"""Minimum width of a movie [pixels], which leaves enough room for the text."""


def movie(
    run: Trajectory | str | Path,
    path: str | Path,
    *,
    colour: str = "species",
    fps: float = 25.0,
    speed: float | None = 1.0,
    stage: str | None = None,
    width: int = WIDTH,
    overwrite: bool = False,
    progress: bool = True,
) -> Path:
    """Write a movie of a run, by default in real time, as MP4 (H.264) or GIF depending on the suffix.

    Between two frames grains follow cubic paths through their positions and velocities in both frames. The
    piston is drawn at its recorded height, and its height is plotted against time below the bed. The scale of
    the bed and the colours are constant; the colour scale ends at the 99th percentile of all values. Ctrl-C
    ends the movie after the current picture, and the file contains all pictures made so far.

    Parameters
    ----------
    run : Trajectory or path
        A run, or its directory.
    path : path
        Path of the file, with the suffix .mp4 or .gif.
    colour : str
        Quantity shown by the colours: a name in `granular.render.picture.COLOURINGS`.
    fps : float
        Pictures per second [1/s], above 0; up to 50 in a GIF and 240 in an MP4.
    speed : float or None
        Seconds of the run shown in one second of the movie, above 0: 1 is real time, 0.1 is ten times slower.
        None for one picture per frame of the run, without interpolation.
    stage : str, optional
        Show only the frames of this stage.
    width : int
        Width of the movie [pixels], from 760 to 960; text keeps its size, and the bed fills the remaining
        width.
    overwrite : bool
        Whether an existing file may be replaced.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    Path
        Path of the written file.

    Raises
    ------
    InputError
        If the run cannot be read, lacks the stage or has no frame in it, the colour or the format is unknown,
        ``fps``, ``speed`` or ``width`` is out of its limits, the file exists or cannot be written, or the
        library ``imageio-ffmpeg`` that an MP4 needs is missing.
    KeyboardInterrupt
        After Ctrl-C, when the file is complete.

    Warns
    -----
    UserWarning
        If frames are so far apart in time that the paths between them are unreliable, or Ctrl-C ended the
        movie.
    """
    colouring_by_name(colour)
    path = Path(path)
    write = _choose_movie_writer(path, fps)
    if speed is not None and not 0.0 < speed < math.inf:
        raise InputError(
            f"speed {speed:g} is not above 0; give 1 for real time, or None for one picture per frame"
        )
    if not MINIMUM_WIDTH <= width <= WIDTH:
        raise InputError(f"width {width} is outside the limits; give {MINIMUM_WIDTH} to {WIDTH} pixels")
    run = load_run_if_path(run)
    numbers = stage_frame_indices(run, stage)
    check_output_file(path, overwrite)
    times = run.dataset["frame_time"].values[numbers]
    if speed is not None:
        times = movie_picture_times(times, speed, fps)
    top = highest_point_of_bed(run, iterate_frames(run, numbers))
    limits = choose_colour_limits(colour, iterate_frames(run, numbers))
    duration = float(times[0]), float(times[-1])
    picture = BedPicture(run, colour, limits, top, duration, width / DPI - LEFT - RIGHT)
    bar = path.name if progress else None
    beds = (
        iterate_frames(run, numbers, bar)
        if speed is None
        else interpolate_frames_at_times(run, numbers, times, bar)
    )
    with defer_stop_signals() as stop:
        with write_atomically(path, overwrite) as part:
            made = write(part, _render_images(picture, beds, stop), fps)
        if made < len(times):
            warnings.warn(
                f"the movie was interrupted: {path} contains {made} of {len(times)} pictures", stacklevel=2
            )
    return path


def stage_frame_indices(run: Trajectory, stage: str | None) -> list[int]:
    """Return the indices of the frames of a stage; without a stage, of all frames."""
    times = run.dataset["frame_time"].values
    if stage is None:
        return list(range(len(times)))
    chosen = run.stage(stage)
    inside = np.flatnonzero((times >= chosen.start) & (times <= chosen.end))
    if not len(inside):
        raise InputError(
            f"stage {stage!r} lasts {chosen.end - chosen.start:g} s and has no frame; reduce "
            "the interval output.frames, or omit the argument stage"
        )
    return [int(index) for index in inside]


def _render_images(picture: BedPicture, beds: Iterator[Frame], stop: StopRequest) -> Iterator[np.ndarray]:
    """Yield the pictures as uint8 (height, width, 3), up to the last picture or until Ctrl-C."""
    for frame in beds:
        picture.show_frame(frame)
        yield picture.pixels()
        if stop.is_requested:
            return


def _choose_movie_writer(path: Path, fps: float) -> Callable[[Path, Iterator[np.ndarray], float], int]:
    if path.suffix.lower() not in WRITERS:
        raise InputError(
            f"unknown format {quote(path.suffix)} of {path.name}; the path of a movie must end in "
            f"{' or '.join(WRITERS)}"
        )
    write, fastest = WRITERS[path.suffix.lower()]
    if not 0.0 < fps <= fastest:
        raise InputError(
            f"fps = {fps:g} is outside the limits of a {path.suffix} movie; give a value above 0, "
            f"at most {fastest:g}"
        )
    return write


def _write_mp4(path: Path, images: Iterator[np.ndarray], fps: float) -> int:
    """Write the pictures with the program ffmpeg; return their number."""
    imageio_ffmpeg = import_extra("imageio_ffmpeg", "an MP4", "movies")
    first = next(images)
    size = (first.shape[1], first.shape[0])
    # H.264 requires even sizes; by default imageio-ffmpeg would stretch pictures to multiples of 16.
    file = imageio_ffmpeg.write_frames(
        str(path), size, fps=fps, codec="libx264", quality=8, macro_block_size=2
    )
    made = 0
    with contextlib.closing(file):
        file.send(None)
        for image in itertools.chain([first], images):
            file.send(image)
            made += 1
    return made


def _write_gif(path: Path, images: Iterator[np.ndarray], fps: float) -> int:
    """Write the pictures with Pillow; return their number."""
    from PIL import Image

    made = 1
    # The first picture contains all colours, in its colour bar or legend.
    first = Image.fromarray(next(images)).quantize(256, method=Image.Quantize.MAXCOVERAGE)
    palette = np.array(first.getpalette()).reshape(-1, 3)
    palette[palette.min(axis=1) > 245] = 255  # the background stays white
    first.putpalette(palette.ravel().tolist())

    def remaining_images() -> Iterator[Any]:
        nonlocal made
        for image in images:
            made += 1
            yield Image.fromarray(image).quantize(palette=first, dither=Image.Dither.NONE)

    first.save(path, save_all=True, append_images=remaining_images(), duration=1000.0 / fps, loop=0)
    return made


WRITERS = {".mp4": (_write_mp4, 240.0), ".gif": (_write_gif, 50.0)}
"""Writer of each movie format, and its maximum number of pictures per second."""


MAXIMUM_DEVIATION = 0.25
"""A warning is given if a grain's path deviates from a straight line by more than this [D]."""


def movie_picture_times(times: Float[np.ndarray, "m"], speed: float, fps: float) -> Float[np.ndarray, "n"]:
    """Return evenly spaced times [s] of a movie's pictures over the times of a run [s]; ``fps`` is in 1/s."""
    start, length = float(times[0]), float(times[-1] - times[0])
    return start + speed / fps * np.arange(int(length * fps / speed * (1.0 + 1e-12)) + 1)


def interpolate_frames_at_times(
    run: Trajectory, numbers: Sequence[int], times: Float[np.ndarray, "n"], bar: str | None = None
) -> Iterator[Frame]:
    """Yield the bed at given times [s] between the frames of a run."""
    frames = iterate_frames(run, numbers, bar)
    before = after = next(frames)
    data, heights = run.dataset, None
    if "piston_height" in data:
        heights = np.interp(times, data["time"].values, data["piston_height"].values)
    deviation = 0.0
    for k, time in enumerate(times):
        while after.time < time:
            following = next(frames, None)
            if following is None:
                break
            before, after = after, following
            deviation = max(deviation, _largest_deviation_from_straight_path(before, after))
        frame = _interpolate_between(before, after, float(time))
        yield frame if heights is None else frame._replace(piston_height=float(heights[k]))
    if deviation > MAXIMUM_DEVIATION * run.scene.grains.diameters().max(initial=0.0):
        warnings.warn(
            f"between two frames a grain deviates from a straight line by {1e3 * deviation:.2g} mm, "
            "so that the paths in the movie are unreliable there; reduce the interval output.frames for "
            "accurate paths",
            stacklevel=2,
        )


def _largest_deviation_from_straight_path(before: Frame, after: Frame) -> float:
    """Return the maximum deviation [m] of a grain's cubic path from a straight line, at its midpoint."""
    velocity_change = before.velocities - after.velocities
    # At its midpoint a cubic path deviates from the straight line by T (v_1 - v_2)/8.
    deviations = (after.time - before.time) / 8.0 * np.hypot(*velocity_change.T)
    return float(np.fmax.reduce(deviations, initial=0.0))


def _interpolate_between(before: Frame, after: Frame, time: float) -> Frame:
    """Interpolate the bed at a time [s] between two frames, with the grains present in both."""
    duration = after.time - before.time
    fraction = min(max((time - before.time) / duration, 0.0), 1.0) if duration > 0.0 else 0.0
    if fraction in (0.0, 1.0):
        return (after if fraction else before)._replace(time=time)
    rest, cell, start = 1.0 - fraction, before.scene.cell, before.positions
    end = start + cell.nearest_image_displacements(after.positions - start)
    leaving, arriving = duration * before.velocities, duration * after.velocities
    position = (
        # Cubic (Hermite) path with the positions and velocities of both frames.
        rest * rest * (1.0 + 2.0 * fraction) * start
        + fraction * fraction * (3.0 - 2.0 * fraction) * end
        + fraction * rest * (rest * leaving - fraction * arriving)
    )
    # Inertia in a shaken cell changes faster than the interval between frames.
    inertia = before.masses[:, None] * acceleration_by_weight_and_shaking(before.scene, time)
    return before._replace(
        time=time,
        positions=cell.wrap_positions(position),
        velocities=rest * before.velocities + fraction * after.velocities,
        further_heights=rest * before.further_heights + fraction * after.further_heights,
        forces=rest * interaction_forces(before) + fraction * interaction_forces(after) + inertia,
    )
