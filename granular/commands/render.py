"""The command ``render``: a still or a movie of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from granular.commands.console import command, given_options, print_result
from granular.commands.options import OutputOptions, RunDirectory, UserCodeOptions
from granular.commands.signature import Hertz, Option, Seconds
from granular.shared.errors import InputError, SceneError, quote


@command("""\
examples:
  %(prog)s runs/bed -o force.png --colour force
  %(prog)s runs/bed -o start.svg --frame 0
  %(prog)s runs/bed -o bed.mp4 --colour sides --stage settle --fps 30
  %(prog)s runs/bed -o slow.mp4 --speed 0.1

colours:
  species       species of each grain
  speed         of each grain
  force         magnitude of the total force of grains and walls on each grain
  compression   sum of the magnitudes of the forces of grains and walls on each grain
  pressure      of each grain, by its virial and its Voronoi cell
  sides         number of sides of the Voronoi cells, which are drawn
  regularity    of the hexagonal Voronoi cells: 1 for a regular hexagon
  fluctuation   |F - mean|/mean of the force, within the species""")
def render(
    run: RunDirectory,
    *,
    out: Annotated[str, Option("a still (.png, .svg, .pdf) or a movie (.mp4, .gif)", "FILE", "-o")],
    colour: Annotated[str, Option("quantity shown by the colours; see below")] = "species",
    frame: Annotated[int | None, Option("number of the still's frame, -1 for the last", "N")] = None,
    time: Annotated[Seconds | None, Option("take the frame nearest to this time [s]", "T")] = None,
    stage: Annotated[str | None, Option("stage shown by the movie (default: all)", "NAME")] = None,
    fps: Annotated[Hertz | None, Option("pictures per second of the movie (default: 25)", "F")] = None,
    speed: Annotated[
        str | None,
        Option(
            "seconds of the run per second of the movie (1: real time); 'frames' for one picture per frame "
            "of "
            "the run",
            "X",
        ),
    ] = None,
    width: Annotated[int | None, Option("width of the movie, 760 to 960 (default: 960)", "PIXELS")] = None,
    force: Annotated[bool, Option("replace an existing file")] = False,
    own: UserCodeOptions,
    output: OutputOptions,
) -> None:
    """Draw a still or a movie of a run."""
    from granular.render.movie import WRITERS, movie
    from granular.render.picture import save_picture, still

    own.import_user_code()
    if Path(out).suffix.lower() in WRITERS:
        if frame is not None or time is not None:
            raise InputError(
                "--frame and --time apply only to stills, not to movies; select a part of a movie "
                "with --stage"
            )
        settings = given_options(fps=fps, width=width, stage=stage)
        playback = _parse_playback_speed(speed)
        path = movie(
            run,
            out,
            colour=colour,
            speed=playback,
            overwrite=force,
            progress=output.shows_progress,
            **settings,
        )
    else:
        if (stage, fps, speed, width) != (None, None, None, None):
            raise InputError(
                "--stage, --fps, --speed and --width are for movies (-o bed.mp4); select the "
                "frame of a still with --frame or --time"
            )
        if frame is not None and time is not None:
            raise InputError("--frame and --time both select a frame; give only one of them")
        drawing = still(run, -1 if frame is None else frame, time=time, colour=colour)
        path = save_picture(drawing, out, overwrite=force)
    print_result({"file": str(path), "colour": colour}, f"drawn to {path}", output.json)


def _parse_playback_speed(words: str | None) -> float | None:
    if words == "frames":
        return None
    from granular.schema.units import si_value

    try:
        return 1.0 if words is None else si_value(words, "1")
    except SceneError:
        raise InputError(
            f"--speed {quote(words)} is not a number; give one such as 0.1, or 'frames'"
        ) from None
