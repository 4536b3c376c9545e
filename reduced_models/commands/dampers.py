"""The commands ``calibrate``, ``design``, ``fall`` and ``derive``: dampers by their scenes."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from granular.commands.console import (
    command,
    given_options,
    option,
    pick_options,
    print_result,
    refuse_options,
    require_options,
)
from granular.commands.options import (
    CHANGES,
    DT,
    IMPORT,
    METHOD,
    OUTPUT,
    PARTS,
    SCENE,
    WORKERS,
    parse_time_step,
    parts_from_options,
    quantity_reader,
    scene_from_options,
)
from granular.shared.errors import InputError
from granular.shared.message_text import quote
from reduced_models.commands.records import READING, parse_reading_options, print_result_and_report_path

OUT = option(
    "-o",
    "--out",
    metavar="DIR",
    help="directory for report, scene and simulations; the same one again goes on",
)


@command(
    "calibrate",
    "fit numbers of a scene to a record, by simulations",
    option("record", metavar="RECORD", help="a record as an instrument wrote it, or a run directory"),
    SCENE,
    CHANGES,
    option(
        "--parameter",
        dest="parameters",
        action="append",
        metavar="KEY",
        help="number of the scene to fit, such as piston.mass, effects.drag.coefficient or "
        "grains.remanence; the first two without (repeatable)",
    ),
    option("--seeds", type=int, default=4, help="random starts of the bed"),
    option(
        "--law",
        default="polynomial-spring",
        metavar="LAW",
        help="law whose rest, period and damping are compared: name or equation",
    ),
    option("--no-checks", action="store_true", help="skip the run with half the step"),
    OUT,
    DT,
    METHOD,
    IMPORT,
    READING,
    OUTPUT,
    examples="""\
examples:
  %(prog)s lab.csv damper -o out
  %(prog)s lab.csv my-damper.toml --parameter piston.mass
  %(prog)s light.csv damper --set 'piston.mass=7.46 kg' \\
      --parameter effects.drag.coefficient --parameter grains.remanence -o out/light
  %(prog)s heavy.csv damper --set 'piston.mass=9.47 kg' \\
      --parameter effects.drag.coefficient --parameter grains.remanence -o out/heavy

rest and frequency know remanence and mass only together, so weigh the piston; if two
weighed masses give two remanences, the zero of the height is off""",
)
def calibrate(options: Any) -> None:
    """Fit numbers of a scene to a record."""
    from granular.run.piston_record import PistonRecord
    from granular.scene.scene import Scene
    from granular.user_code import import_user_code
    from reduced_models.calibration.calibrate import calibrate as calibrate_scene
    from reduced_models.records.sources import open_source

    import_user_code(options.user_files)
    source = open_source(options.record, parse_reading_options(options))
    if isinstance(source, Scene):
        raise InputError(f"{quote(options.record)} is a scene; give a record, a CSV or Parquet file")
    record = source if isinstance(source, PistonRecord) else source.piston()
    with _say_where_results_are(options.out):
        result = calibrate_scene(
            record,
            scene_from_options(options),
            **given_options(options, "parameters"),
            dt=parse_time_step(options.dt),
            checks=not options.no_checks,
            progress=not options.quiet,
            **pick_options(options, "seeds", "law", "method", "out"),
        )
    print_result_and_report_path(result, options)


@command(
    "design",
    "choose mass, grains and drag for a wanted frequency and damping",
    option(
        "--frequency",
        type=quantity_reader("Hz"),
        metavar="F",
        help="of the undamped small swing about rest [Hz]",
    ),
    option("--damping", type=quantity_reader("1"), metavar="R", help="damping ratio, as 0.04 or '4 %%'"),
    option("--grains", type=int, metavar="N", help="number of grains; chosen if not given"),
    option(
        "--mass", type=quantity_reader("kg"), metavar="M", help="mass of the piston [kg]; chosen if not given"
    ),
    option(
        "--small-share",
        type=quantity_reader("1"),
        default=0.0,
        metavar="S",
        help="fraction of grains of 0.6 D (0)",
    ),
    option("--magnets", choices=("dipoles", "cylinders"), default="dipoles", help="what repels (dipoles)"),
    PARTS,
    OUT,
    WORKERS,
    OUTPUT,
    examples="""\
examples:
  %(prog)s --frequency 3.2 --damping 0.1 -o out
  %(prog)s --frequency 4 --damping 0.05 --mass 5 -o out
  %(prog)s --frequency 3.2 --damping 0.05 --magnets cylinders -o out
  %(prog)s --frequency 3.2 --damping 0.1 --usual""",
)
def design(options: Any) -> None:
    """Propose a damper and check it."""
    if options.workers is not None and options.workers < 1:
        raise InputError(f"--workers {options.workers}; give 1 or more")
    require_options(options, frequency="--frequency", damping="--damping")
    from granular.studies.tolerance_parts import read_parts
    from granular.studies.tolerances import tolerances_at
    from reduced_models.designs.damper import DamperCandidate
    from reduced_models.designs.design import design as design_damper
    from reduced_models.records.sources import make_directory

    parts = None
    if options.parts or options.usual:
        # Every design has these keys: wrong ones are refused before it.
        scene = DamperCandidate(7.5, 368, 0.1, options.small_share, options.magnets).scene()
        parts = parts_from_options(options, scene)
        read_parts(scene, parts)
    with _say_where_results_are(options.out):
        result = design_damper(
            options.frequency,
            options.damping,
            out=make_directory(options.out),
            progress=not options.quiet,
            **pick_options(options, "grains", "mass", "small_share", "magnets", "workers"),
        )
    text, plain = str(result), result.to_plain()
    if parts is not None:
        rests = [check.equilibrium(result.damper) for check in result.checks]
        of_parts = tolerances_at(rests, read_parts(rests[0].scene, parts), progress=not options.quiet)
        text, plain = f"{text}\n{of_parts}", plain | {"of_parts": of_parts.to_plain()}
        if options.out is not None:
            result.page(of_parts).save(Path(options.out) / "report.html")
    if options.out is not None:
        text += f"\nreport: {options.out}/report.html"
    print_result(plain, text, options.json)


@contextlib.contextmanager
def _say_where_results_are(out: str | None) -> Iterator[None]:
    """Let the message of a stop say where the finished simulations are."""
    try:
        yield
    except KeyboardInterrupt as stop:
        if out is not None:
            stop.saved = f"finished simulations are kept in {out}; the same command goes on"  # type: ignore[attr-defined]
        raise


@command(
    "fall",
    "predict a whole fall from the scene alone",
    SCENE,
    CHANGES,
    option("--height", type=quantity_reader("m"), metavar="H", help="of the start [m]; the scene's without"),
    option(
        "--law-only",
        action="store_true",
        help="do not simulate the fall where the law was compared with nothing",
    ),
    OUTPUT,
    examples="""\
examples:
  %(prog)s damper --height '144 mm'
  %(prog)s damper --set piston.mass=10 --set 'effects.drag.coefficient=0.2 kg/s'""",
)
def fall(options: Any) -> None:
    """Tell what a fall does, from the scene alone, and simulate it where that is uncertain."""
    from reduced_models.falls.fall_summary import whole_fall

    predicted = whole_fall(
        scene_from_options(options),
        options.height,
        simulate=False if options.law_only else None,
        progress=not options.quiet,
    )
    figures = predicted._asdict()
    if predicted.simulated is not None:
        figures["simulated"] = predicted.simulated._asdict()
    print_result(figures, str(predicted), options.json)


@command(
    "derive",
    "derive a damper's law from its equilibria and roots, without a fit",
    option("source", metavar="SOURCE", help="a scene (name or TOML file), or a run directory"),
    CHANGES,
    option(
        "--reach",
        type=quantity_reader("m"),
        metavar="R",
        help="range to both sides of the equilibrium [m]; the scene's lift without, or 0.2 D",
    ),
    option("--order", type=int, metavar="N", help="order of the force; the lowest that suffices without"),
    option(
        "--against",
        metavar="RECORD",
        help="a free oscillation to compare with, a run directory or a record; the release of SOURCE without",
    ),
    option("-o", "--save", metavar="FILE", help="model, as JSON"),
    IMPORT,
    OUTPUT,
    examples="""\
examples:
  %(prog)s runs/damper --reach '1.2 mm' --save model.json
  %(prog)s damper --set piston.mass=9 --against runs/damper""",
)
def derive(options: Any) -> None:
    """Derive a law, compare it with a free oscillation if there is one, and save it."""
    from granular.commands.options import parse_changes
    from granular.scene.scene import Scene
    from granular.user_code import import_user_code
    from reduced_models.derived.derive import derive as derive_law
    from reduced_models.records.sources import open_source

    import_user_code(options.user_files)
    source: Any = open_source(options.source)
    if isinstance(source, Scene):
        source = source.replace(**parse_changes(options.changes))
    else:
        refuse_options(options, "a run, only with a scene", "changes")
    model = derive_law(source, **pick_options(options, "reach", "order", "against"))
    text = str(model)
    if options.save is not None:
        model.save(options.save)
        text += f"\nmodel: {options.save}"
    plain = {
        "model": model.to_plain(),
        "instabilities": [item._asdict() for item in model.instabilities],
        "error": None if model.error is None else model.error._asdict(),
    }
    print_result(plain, text, options.json)
