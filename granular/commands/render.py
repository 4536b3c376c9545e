"""The command ``render``: a still or a movie of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from granular.commands.console import command, option, print_result
from granular.commands.options import IMPORT, OUTPUT, RUN, quantity_reader
from granular.shared.errors import InputError, SceneError
from granular.shared.message_text import quote


@command(
    "render",
    "draw a still or a movie of a run",
    RUN,
    option(
        "-o",
        "--out",
        metavar="FILE",
        required=True,
        help="a still (.png, .svg, .pdf) or a movie (.mp4, .gif)",
    ),
    option("--colour", default="species", help="what the colours show; see below"),
    option("--frame", type=int, metavar="N", help="number of the still's frame, -1 for the last"),
    option("--time", metavar="T", help="take the frame nearest to this time [s]"),
    option("--stage", metavar="NAME", help="the movie shows this stage only"),
    option("--fps", type=quantity_reader("Hz"), metavar="F", help="pictures a second of the movie (25)"),
    option(
        "--speed",
        metavar="X",
        help="seconds of the run in a second of the movie (1: real time); 'frames' for a picture a "
        "frame of the run",
    ),
    option("--width", type=int, metavar="PIXELS", help="width of the movie, 760 to 960 (960)"),
    option("--force", action="store_true", help="replace the file if it is there"),
    IMPORT,
    OUTPUT,
    examples="""\
examples:
  %(prog)s runs/bed -o force.png --colour force
  %(prog)s runs/bed -o start.svg --frame 0
  %(prog)s runs/bed -o bed.mp4 --colour sides --stage settle --fps 30
  %(prog)s runs/bed -o slow.mp4 --speed 0.1

colours:
  species       which species a grain is of
  speed         of each grain
  force         magnitude of the resulting force of grains and walls on each grain
  compression   sum of the magnitudes of the forces of grains and walls on each grain
  pressure      of each grain, by its virial and its Voronoi cell
  sides         number of sides of the Voronoi cells, drawn
  regularity    of the hexagonal Voronoi cells: 1 for a regular hexagon
  fluctuation   |F - mean|/mean of the force, within the species""",
)
def render(options: Any) -> None:
    """Draw a still or a movie of a run to a file, by the ending of its name."""
    from granular.render.movie import WRITERS
    from granular.user_code import import_user_code

    import_user_code(options.user_files)
    path = (_render_movie if Path(options.out).suffix.lower() in WRITERS else _render_still)(options)
    print_result({"file": str(path), "colour": options.colour}, f"drawn to {path}", options.json)


def _render_still(options: Any) -> Path:
    from granular.render import save_picture, still
    from granular.schema.units import si_value

    if (options.stage, options.fps, options.speed, options.width) != (None, None, None, None):
        raise InputError(
            "--stage, --fps, --speed and --width are for movies (-o bed.mp4); choose a still's "
            "frame with --frame or --time"
        )
    if options.frame is not None and options.time is not None:
        raise InputError("--frame and --time name two frames; give one of them")
    time = None if options.time is None else si_value(options.time, "s")
    number = -1 if options.frame is None else options.frame
    figure = still(options.run, number, time=time, colour=options.colour)
    return save_picture(figure, options.out, overwrite=options.force)


def _render_movie(options: Any) -> Path:
    from granular.render import movie
    from granular.render.movie import WIDTH

    if options.frame is not None or options.time is not None:
        raise InputError("--frame and --time are for stills; choose a movie's part with --stage")
    return movie(
        options.run,
        options.out,
        colour=options.colour,
        fps=25.0 if options.fps is None else options.fps,
        speed=_parse_playback_speed(options.speed),
        stage=options.stage,
        width=WIDTH if options.width is None else options.width,
        overwrite=options.force,
        progress=not options.quiet,
    )


def _parse_playback_speed(words: str | None) -> float | None:
    if words == "frames":
        return None
    from granular.schema.units import si_value

    try:
        return 1.0 if words is None else si_value(words, "1")
    except SceneError:
        raise InputError(f"--speed {quote(words)}; give a number such as 0.1, or 'frames'") from None
