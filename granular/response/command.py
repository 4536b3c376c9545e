"""The command ``response``: frequency or impulse response of a machine that carries a damper."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from granular.commands.console import command, given_options, print_result, refuse_options, require_options
from granular.commands.options import OutputOptions, SceneChangeOptions, SceneName, TimeStep, WorkerCount
from granular.commands.signature import Fraction, Hertz, Option, Seconds, make_quantity_reader
from granular.shared.blocks import Block, Text
from granular.shared.errors import InputError, quote
from granular.shared.files import make_directory, write_text

if TYPE_CHECKING:
    import pandas

    from granular.response.response import FrequencyResponse
    from granular.response.transients import ImpulseResponse
    from granular.scene.scene import Scene

POINTS = 25
"""Default number of frequencies at which the machine is driven."""


@dataclasses.dataclass(frozen=True)
class DriveOptions:
    """Amplitudes of the force on the machine, or of the motion of its base."""

    force: Annotated[
        tuple[Annotated[float, make_quantity_reader("N")], ...],
        Option("amplitude of the force (repeatable), or peak force of an impulse", "X"),
    ] = ()
    acceleration: Annotated[
        tuple[Annotated[float, make_quantity_reader("m/s^2")], ...],
        Option("amplitude of the acceleration (repeatable)", "X"),
    ] = ()
    displacement: Annotated[
        tuple[Annotated[float, make_quantity_reader("m")], ...],
        Option("amplitude of the displacement (repeatable)", "X"),
    ] = ()

    def scene_and_amplitudes(self, scene: Scene) -> tuple[Scene, list[float] | None]:
        """Return the scene with the first given amplitude of the drive, and all given amplitudes."""
        given = {name: list(sizes) for name, sizes in vars(self).items() if sizes}
        if len(given) > 1:
            raise InputError(f"--{' and --'.join(given)} cannot be combined; use one of them")
        host = scene.effects.host
        if host is None:
            raise InputError(
                f"the scene {quote(scene.name)} has no host; add effects.host, or use the packaged "
                "scene 'machine'"
            )
        if not given and host.excitation is None:
            raise InputError(
                f"the host of {quote(scene.name)} has no drive; add --force, --acceleration or --displacement"
            )
        for name, sizes in given.items():
            saved = {"kind": "sine", "frequency": 1.0, name: sizes[0]}
            if host.excitation is not None:
                saved["start"] = host.excitation.start
            scene = scene.replace(**{"effects.host.excitation": saved})
        return scene, next(iter(given.values()), None)


@command("""\
examples:
  %(prog)s machine --from 2.6Hz --to 3.6Hz --points 9 --dt 'auto*4' -o out/machine
  %(prog)s machine --from 2.8Hz --to 3Hz --points 3 --dt 'auto*4' --force 5N --force 10N -o two
  %(prog)s machine --from 2.5Hz --to 3.5Hz --sweep 40s --dt 'auto*4' -o out/sweep
  %(prog)s machine --impulse --force 500N --fraction 0.1 --dt 'auto*4' -o out/impulse
  %(prog)s machine --impulse --force 500N --fraction 0.5 --duration 6s --dt 'auto*4'

Each sine is a separate run; --sweep covers all frequencies in one run. report.html in DIR shows the
results.""")
def response(
    scene: SceneName,
    *,
    changes: SceneChangeOptions,
    lowest: Annotated[Hertz | None, Option("lowest frequency of the sine", "F", name="--from")] = None,
    highest: Annotated[Hertz | None, Option("highest frequency of the sine", "F", name="--to")] = None,
    points: Annotated[int | None, Option("number of frequencies (default 25, with --sweep 200)", "N")] = None,
    drive: DriveOptions,
    duration: Annotated[
        Seconds | None,
        Option("duration of each sine (default 20 s), or of the run after an impulse (default 10 s)", "T"),
    ] = None,
    sweep: Annotated[
        Seconds | None,
        Option(
            "instead of sines, make one run with a sweep of this duration from the lowest to the "
            "highest frequency, at the first of the given amplitudes",
            "T",
        ),
    ] = None,
    impulse: Annotated[
        bool, Option("instead of sines, apply one half-sine impulse and print the settling time")
    ] = False,
    length: Annotated[Seconds | None, Option("duration of the impulse (default 20 ms)", "T")] = None,
    fraction: Annotated[
        Fraction | None,
        Option("fraction of the peak that defines the settling time: 0.1 (default) or '10 %%'", "S"),
    ] = None,
    out: Annotated[
        str | None,
        Option(
            "directory for report.html, response.csv and response.png, or for impulse.csv and "
            "impulse.png; finished runs are kept there",
            "DIR",
            "-o",
        ),
    ] = None,
    dt: TimeStep = "auto",
    workers: WorkerCount = None,
    output: OutputOptions,
) -> None:
    """Compute the frequency response or settling time of a machine with a damper."""
    settings: dict[str, Any] = {"dt": dt, "out": out, "progress": output.shows_progress}
    settings |= given_options(duration=duration)
    loaded = changes.load(scene)
    if impulse:
        require_options(force=drive.force)
        refuse_options("--impulse", points=points, acceleration=drive.acceleration)
        refuse_options("--impulse", displacement=drive.displacement, sweep=sweep, workers=workers)
        refuse_options("--impulse", from_=lowest, to=highest)
        _run_and_print_impulse(
            loaded, drive.force, given_options(fraction=fraction, length=length) | settings, output
        )
        return
    require_options(from_=lowest, to=highest)
    refuse_options("sines", length=length, fraction=fraction)
    assert lowest is not None
    assert highest is not None
    count = POINTS if points is None else points
    if not 0.0 < lowest < highest or count < 2:
        raise InputError(
            f"--from {lowest:g} --to {highest:g} --points {count}: --from must be above 0 and below --to, "
            "and --points must be 2 or more"
        )
    if sweep is not None:
        refuse_options("--sweep", duration=duration, workers=workers)
    import numpy as np

    from granular.response.response import frequency_response
    from granular.response.transients import run_frequency_sweep

    shaken, sizes = drive.scene_and_amplitudes(loaded)
    if sweep is None:
        frequencies = np.geomspace(lowest, highest, count).tolist()
        result = frequency_response(shaken, frequencies, amplitudes=sizes, workers=workers, **settings)
    else:
        result = run_frequency_sweep(
            shaken, lowest, highest, sweep, **settings, **given_options(points=points)
        )
    _print_response(result, sweep is not None, out, output)


def _print_response(result: FrequencyResponse, swept: bool, out: str | None, output: OutputOptions) -> None:
    """Print the peaks of the machine's displacement with and without the damper."""
    from granular.response.transients import relative_sweep_rate_at_peak

    blocks: list[Block] = [result.table]
    figures: dict[str, Any] = {"peaks": result.peaks(), "out": out}
    if swept:
        figures["sweep_rate"] = relative_sweep_rate_at_peak(result)
        if figures["sweep_rate"] is not None:
            blocks.append(
                Text(
                    f"sweep rate at the peak: {figures['sweep_rate']:.2g} times the fastest rate that the "
                    "machine with its damper can follow; this factor should be far below 1"
                )
            )
    if out is not None:
        blocks.append(Text(_write_response_files(result, Path(out))))
    print_result(figures, blocks, output.json)


def _run_and_print_impulse(
    scene: Scene, forces: tuple[float, ...], settings: dict[str, Any], output: OutputOptions
) -> None:
    """Apply an impulse to the machine and print its settling time."""
    from granular.response.transients import run_impulse

    if len(forces) > 1:
        raise InputError(
            f"--force is given {len(forces)} times; give it once, because an impulse has one force"
        )
    result, out = run_impulse(scene, forces[0], **settings), settings["out"]
    figures: dict[str, Any] = {
        "seconds": result.settling_time,
        "alone": result.settling_time_without_damper,
        "fraction": result.fraction,
        "peak": result.peak,
        "out": out,
    }
    lines = [str(result)]
    if out is not None:
        _write_table_and_picture(Path(out), "impulse", result.table, result)
        lines.append(f"written to {Path(out)}: impulse.csv, impulse.png")
    print_result(figures, "\n".join(lines), output.json)


def _write_table_and_picture(
    path: Path, name: str, table: pandas.DataFrame, result: FrequencyResponse | ImpulseResponse
) -> None:
    from granular.shared.plotting import figure

    make_directory(path)
    write_text(path / f"{name}.csv", table.to_csv(index=False))
    with figure() as (drawing, axes):
        result.plot(axes)
        drawing.savefig(path / f"{name}.png", dpi=150)


def _write_response_files(result: FrequencyResponse, path: Path) -> str:
    from granular.response.report_page import add_linear_response, response_page
    from granular.response.response import save_response

    result = add_linear_response(result)
    save_response(result, path)
    _write_table_and_picture(path, "response", result.dataset.to_dataframe().reset_index(), result)
    response_page(result).save(path / "report.html")
    return f"written to {path}: report.html, response.csv, response.png"
