"""The command ``response``: a machine that carries a damper, shaken or struck."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.commands.console import (
    command,
    given_options,
    option,
    print_result,
    refuse_options,
    require_options,
)
from granular.commands.options import (
    CHANGES,
    DT,
    IMPORT,
    OUTPUT,
    SCENE,
    WORKERS,
    parse_time_step,
    quantity_reader,
    scene_from_options,
)
from granular.shared.errors import InputError
from granular.shared.files import make_directory, write_text
from granular.shared.message_text import quote

if TYPE_CHECKING:
    import pandas

    from granular.response.response import FrequencyResponse
    from granular.response.transients import ImpulseResponse
    from granular.scene.scene import Scene

POINTS = 25
"""Frequencies of sines, if not given."""


@command(
    "response",
    "frequency response of a machine that carries a damper, or how soon it settles",
    SCENE,
    CHANGES,
    option(
        "--from", dest="lowest", type=quantity_reader("Hz"), metavar="F", help="lowest frequency of the sine"
    ),
    option(
        "--to", dest="highest", type=quantity_reader("Hz"), metavar="F", help="highest frequency of the sine"
    ),
    option("--points", type=int, metavar="N", help="frequencies (25; 200 read off a sweep)"),
    *(
        option(
            f"--{name}",
            type=quantity_reader(unit),
            action="append",
            metavar="X",
            help=f"amplitude of the {name} (repeatable){more}",
        )
        for name, unit, more in (
            ("force", "N", "; peak of an impulse"),
            ("acceleration", "m/s^2", ""),
            ("displacement", "m", ""),
        )
    ),
    option(
        "--duration",
        type=quantity_reader("s"),
        metavar="T",
        help="how long each sine acts (20 s), or a struck machine is looked at (10 s)",
    ),
    option(
        "--sweep",
        type=quantity_reader("s"),
        metavar="T",
        help="in place of sines, one run under a sweep from the lowest to the highest frequency "
        "that takes this long, of the first amplitude",
    ),
    option(
        "--impulse",
        action="store_true",
        help="in place of sines, strike the machine once, by half a sine in time, and say how soon "
        "it is down",
    ),
    option("--length", type=quantity_reader("s"), metavar="T", help="of the impulse (20 ms)"),
    option(
        "--fraction",
        type=quantity_reader("1"),
        metavar="S",
        help="fraction of its peak within which a struck machine is down: 0.1 (default) or '10 %%'",
    ),
    option(
        "-o",
        "--out",
        metavar="DIR",
        help="directory for report.html, response.csv and response.png, or for impulse.csv and "
        "impulse.png, which keeps what is done",
    ),
    DT,
    WORKERS,
    IMPORT,
    OUTPUT,
    examples="""\
examples:
  %(prog)s machine --from 2.6Hz --to 3.6Hz --points 9 --dt 'auto*4' -o out/machine
  %(prog)s machine --from 2.8Hz --to 3Hz --points 3 --dt 'auto*4' --force 5N --force 10N -o two
  %(prog)s machine --from 2.5Hz --to 3.5Hz --sweep 40s --dt 'auto*4' -o out/sweep
  %(prog)s machine --impulse --force 500N --fraction 0.1 --dt 'auto*4' -o out/impulse
  %(prog)s machine --impulse --force 500N --fraction 0.5 --duration 6s --dt 'auto*4'

Each sine is a run; --sweep makes one run of all. report.html in DIR shows what was found.""",
)
def response(options: Any) -> None:
    """Measure the response of a machine with its damper to sines, a sweep or an impulse."""
    if options.impulse:
        _measure_impulse_response(options)
    else:
        _measure_frequency_response(options)


def _measure_frequency_response(options: Any) -> None:
    """Run the sines, or the sweep, and say how far the machine moves."""
    require_options(options, lowest="--from", highest="--to")
    refuse_options(options, "sines", "length", "fraction")
    points = POINTS if options.points is None else options.points
    if not 0.0 < options.lowest < options.highest or points < 2:
        raise InputError(
            f"--from {options.lowest:g} --to {options.highest:g} --points {points}: give "
            "two frequencies, the lower one first, and at least 2 points"
        )
    import numpy as np

    from granular.response.response import frequency_response
    from granular.response.transients import run_frequency_sweep, sweep_rate_at_peak

    scene, sizes = _scene_and_drive_amplitudes(options)
    settings = {"dt": parse_time_step(options.dt), "out": options.out, "progress": not options.quiet}
    if options.sweep is not None:
        refuse_options(options, "a sweep, only with sines", "duration", "workers")
        settings |= given_options(options, "points")
        result = run_frequency_sweep(scene, options.lowest, options.highest, options.sweep, **settings)
    else:
        settings |= given_options(options, "duration")
        frequencies = np.geomspace(options.lowest, options.highest, points).tolist()
        result = frequency_response(scene, frequencies, amplitudes=sizes, workers=options.workers, **settings)
    lines, figures = [result.table], {"peaks": result.peaks(), "out": options.out}
    if options.sweep is not None:
        figures["sweep_rate"] = sweep_rate_at_peak(result)
        if figures["sweep_rate"] is not None:
            lines.append(
                f"sweep rate at the peak: {figures['sweep_rate']:.2g} of what the machine with "
                "its damper can follow; far below 1 is slow enough"
            )
    if options.out is not None:
        lines.append(_write_response(result, Path(options.out)))
    print_result(figures, "\n".join(lines), options.json)


def _measure_impulse_response(options: Any) -> None:
    """Strike the machine and say how soon it is down."""
    from granular.response.transients import run_impulse

    require_options(options, force="--force")
    wrong = ("points", "acceleration", "displacement", "sweep", "workers")
    refuse_options(options, "--impulse", *wrong, lowest="--from", highest="--to")
    if len(options.force) > 1:
        raise InputError(f"--force is given {len(options.force)} times; an impulse has one")
    result = run_impulse(
        scene_from_options(options),
        options.force[0],
        **given_options(options, "fraction", "length", "duration"),
        dt=parse_time_step(options.dt),
        out=options.out,
        progress=not options.quiet,
    )
    figures: dict[str, Any] = {
        "seconds": result.settling_time,
        "alone": result.settling_time_without_damper,
        "fraction": result.fraction,
        "peak": result.peak,
        "out": options.out,
    }
    lines = [str(result)]
    if options.out is not None:
        _write_table_and_picture(Path(options.out), "impulse", result.table, result)
        lines.append(f"written to {Path(options.out)}: impulse.csv, impulse.png")
    print_result(figures, "\n".join(lines), options.json)


def _write_table_and_picture(
    path: Path, name: str, table: pandas.DataFrame, result: FrequencyResponse | ImpulseResponse
) -> None:
    from granular.shared.plotting import figure

    make_directory(path)
    write_text(path / f"{name}.csv", table.to_csv(index=False))
    with figure() as (drawing, axes):
        result.plot(axes)
        drawing.savefig(path / f"{name}.png", dpi=150)


def _scene_and_drive_amplitudes(options: Any) -> tuple[Scene, list[float] | None]:
    """Scene under the first amplitude that was given, and all of them."""
    from granular.response.response import AMPLITUDES

    scene = scene_from_options(options)
    given = {name: getattr(options, name) for name in AMPLITUDES if getattr(options, name)}
    if len(given) > 1:
        raise InputError(f"--{' and --'.join(given)} together; give one of them")
    host = scene.effects.host
    if host is None:
        raise InputError(
            f"the scene {quote(scene.name)} has no host; give it effects.host, or take the "
            "packaged scene 'machine'"
        )
    if not given and host.excitation is None:
        raise InputError(
            f"nothing shakes the host of {quote(scene.name)}; give --force, --acceleration or --displacement"
        )
    for name, sizes in given.items():
        saved = {"kind": "sine", "frequency": 1.0, name: sizes[0]}
        if host.excitation is not None:
            saved["start"] = host.excitation.start
        scene = scene.replace(**{"effects.host.excitation": saved})
    return scene, next(iter(given.values()), None)


def _write_response(result: FrequencyResponse, path: Path) -> str:
    from granular.response.report_page import response_page
    from granular.response.response import save_response
    from granular.response.small_amplitude import add_linear_response

    result = add_linear_response(result)
    save_response(result, path)
    _write_table_and_picture(path, "response", result.dataset.to_dataframe().reset_index(), result)
    response_page(result).save(path / "report.html")
    return f"written to {path}: report.html, response.csv, response.png"
