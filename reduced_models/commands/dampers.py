"""The commands ``calibrate``, ``design``, ``fall`` and ``derive``, for dampers described by scenes."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from granular.commands.console import command, given_options, print_result, refuse_options
from granular.commands.options import (
    MethodName,
    OutputOptions,
    SceneChangeOptions,
    SceneName,
    TimeStep,
    ToleranceOptions,
    WorkerCount,
)
from granular.commands.signature import Fraction, Hertz, Kilograms, Metres, Option
from granular.shared.errors import InputError, quote
from reduced_models.commands.records import ReadingOptions, print_result_and_report_path

OutputDirectory = Annotated[
    str | None,
    Option("directory for report, scene and simulations; an existing one is continued", "DIR", "-o"),
]


@command("""\
examples:
  %(prog)s lab.csv damper -o out
  %(prog)s lab.csv my-damper.toml --parameter piston.mass
  %(prog)s light.csv damper --set 'piston.mass=7.46 kg' \\
      --parameter effects.drag.coefficient --parameter grains.remanence -o out/light
  %(prog)s heavy.csv damper --set 'piston.mass=9.47 kg' \\
      --parameter effects.drag.coefficient --parameter grains.remanence -o out/heavy

equilibrium and frequency depend only on a combination of remanence and mass, so weigh the
piston; if two weighed masses give two remanences, the zero of the height is wrong""")
def calibrate(
    record: Annotated[str, Option("a record from an instrument, or a run directory", "RECORD")],
    scene: SceneName,
    *,
    changes: SceneChangeOptions,
    parameters: Annotated[
        tuple[str, ...],
        Option(
            "quantity of the scene that is fitted, such as piston.mass, effects.drag.coefficient or "
            "grains.remanence; by default the first two (repeatable)",
            "KEY",
            name="--parameter",
        ),
    ] = (),
    seeds: Annotated[int, Option("number of random packings of the bed")] = 4,
    law: Annotated[
        str, Option("law whose equilibrium, period and damping are compared: name or equation", "LAW")
    ] = "polynomial-spring",
    no_checks: Annotated[bool, Option("skip the check run with half the time step")] = False,
    out: OutputDirectory = None,
    dt: TimeStep = "auto",
    method: MethodName = "stormer-verlet",
    reading: ReadingOptions,
    output: OutputOptions,
) -> None:
    """Fit parameters of a scene to a record, by simulations."""
    from granular.records.record import PistonRecord
    from granular.scene.scene import Scene
    from reduced_models.calibration.calibrate import calibrate as calibrate_scene
    from reduced_models.records.sources import open_source

    changes.import_user_code()
    source = open_source(record, reading.parse())
    if isinstance(source, Scene):
        raise InputError(f"{quote(record)} is a scene; give a record, a CSV or Parquet file")
    settings: dict[str, Any] = given_options(parameters=parameters or None)
    with _add_directory_to_interrupt_message(out):
        result = calibrate_scene(
            source if isinstance(source, PistonRecord) else source.piston(),
            changes.load(scene),
            seeds=seeds,
            law=law,
            dt=dt,
            method=method,
            out=out,
            checks=not no_checks,
            progress=output.shows_progress,
            **settings,
        )
    print_result_and_report_path(result, out, output)


@command("""\
examples:
  %(prog)s --frequency 3.2 --damping 0.1 -o out
  %(prog)s --frequency 4 --damping 0.05 --mass 5 -o out
  %(prog)s --frequency 3.2 --damping 0.05 --magnets cylinders -o out
  %(prog)s --frequency 3.2 --damping 0.1 --usual""")
def design(
    *,
    frequency: Annotated[Hertz, Option("undamped frequency of small oscillations [Hz]", "F")],
    damping: Annotated[Fraction, Option("damping ratio, such as 0.04 or '4 %%'", "R")],
    grains: Annotated[int | None, Option("number of grains; chosen if not given", "N")] = None,
    mass: Annotated[Kilograms | None, Option("mass of the piston [kg]; chosen if not given", "M")] = None,
    small_share: Annotated[Fraction, Option("fraction of small grains of diameter 0.6 D (0)", "S")] = 0.0,
    magnets: Annotated[Literal["dipoles", "cylinders"], Option("kind of magnets (dipoles)")] = "dipoles",
    parts: ToleranceOptions,
    out: OutputDirectory = None,
    workers: WorkerCount = None,
    output: OutputOptions,
) -> None:
    """Choose mass, grains and drag of a damper for a given frequency and damping."""
    if workers is not None and workers < 1:
        raise InputError(f"--workers {workers}; give 1 or more")
    from granular.studies.tolerances import read_part_tolerances, tolerances_at
    from reduced_models.designs.damper import DamperCandidate
    from reduced_models.designs.design import design as design_damper
    from reduced_models.records.sources import make_directory

    tolerances = None
    if parts:
        # Every design has these keys, so wrong ones are refused before the search.
        scene = DamperCandidate(7.5, 368, 0.1, small_share, magnets).scene()
        tolerances = parts.tolerances_by_key(scene)
        read_part_tolerances(scene, tolerances)
    with _add_directory_to_interrupt_message(out):
        result = design_damper(
            frequency,
            damping,
            grains=grains,
            mass=mass,
            small_share=small_share,
            magnets=magnets,
            out=None if out is None else make_directory(out),
            workers=workers,
            progress=output.shows_progress,
        )
    text, plain = str(result), result.to_plain()
    if tolerances is not None:
        rests = [check.equilibrium(result.damper) for check in result.checks]
        of_parts = tolerances_at(
            rests, read_part_tolerances(rests[0].scene, tolerances), progress=output.shows_progress
        )
        text, plain = f"{text}\n{of_parts}", plain | {"of_parts": of_parts.to_plain()}
        if out is not None:
            result.page(of_parts).save(Path(out) / "report.html")
    if out is not None:
        text += f"\nreport: {out}/report.html"
    print_result(plain, text, output.json)


@contextlib.contextmanager
def _add_directory_to_interrupt_message(out: str | None) -> Iterator[None]:
    """Add the directory of the finished simulations to the message of an interrupt."""
    try:
        yield
    except KeyboardInterrupt as stop:
        if out is not None:
            stop.saved = f"finished simulations are kept in {out}; repeat the command to continue"  # type: ignore[attr-defined]
        raise


@command("""\
examples:
  %(prog)s damper --height '144 mm'
  %(prog)s damper --set piston.mass=10 --set 'effects.drag.coefficient=0.2 kg/s'""")
def fall(
    scene: SceneName,
    *,
    changes: SceneChangeOptions,
    height: Annotated[Metres | None, Option("initial height [m]; by default the scene's", "H")] = None,
    law_only: Annotated[
        bool, Option("use only the law; do not simulate the fall, even outside the law's tested range")
    ] = False,
    output: OutputOptions,
) -> None:
    """Predict a whole fall from the scene alone."""
    from reduced_models.falls.unseen_fall_scores import whole_fall

    predicted = whole_fall(
        changes.load(scene), height, simulate=False if law_only else None, progress=output.shows_progress
    )
    figures = predicted._asdict()
    if predicted.simulated is not None:
        figures["simulated"] = predicted.simulated._asdict()
    print_result(figures, str(predicted), output.json)


@command("""\
examples:
  %(prog)s runs/damper --reach '1.2 mm' --save model.json
  %(prog)s damper --set piston.mass=9 --against runs/damper""")
def derive(
    source: Annotated[str, Option("a scene (name or TOML file), or a run directory", "SOURCE")],
    *,
    changes: SceneChangeOptions,
    reach: Annotated[
        Metres | None,
        Option("range on both sides of the equilibrium [m]; by default the scene's lift or 0.2 D", "R"),
    ] = None,
    order: Annotated[
        int | None, Option("order of the polynomial of the force; by default the lowest sufficient one", "N")
    ] = None,
    against: Annotated[
        str | None,
        Option(
            "free oscillation for comparison, a run directory or a record; by default the release of SOURCE",
            "RECORD",
        ),
    ] = None,
    save: Annotated[str | None, Option("JSON file for the model", "FILE", "-o")] = None,
    output: OutputOptions,
) -> None:
    """Derive a damper's law from its equilibria and the roots of its small motions, without a fit."""
    from granular.scene.scene import Scene
    from reduced_models.derived.derive import derive as derive_law
    from reduced_models.records.sources import open_source

    changes.import_user_code()
    opened: Any = open_source(source)
    if isinstance(opened, Scene):
        opened = changes.apply(opened)
    else:
        refuse_options("a run, because it changes a scene", set=changes.changes)
    model = derive_law(opened, reach=reach, order=order, against=against)
    text = str(model)
    if save is not None:
        model.save(save)
        text += f"\nmodel: {save}"
    plain = {
        "model": model.to_plain(),
        "instabilities": [item._asdict() for item in model.instabilities],
        "error": None if model.error is None else model.error._asdict(),
    }
    print_result(plain, text, output.json)
