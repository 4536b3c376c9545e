"""Command line of the validation: ``python -m validation``."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from granular.commands.console import Command, Option, Program, command, emit, group, launch, option
from granular.commands.options import (
    CHANGES,
    IMPORT,
    OUTPUT,
    SCENE,
    changes_from,
    in_unit,
    scene_of,
)
from granular.shared.errors import InputError

REPORT = "out/validation"
"""Directory of the report where none is given."""

METHOD_REPORT = "out/method"
"""The same, of a user's own methods."""

UNTIL = option("--t-end", type=in_unit("s"), metavar="T", help="stop each run at this time [s]")


def _length(parser: argparse._ActionsContainer) -> None:
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--quick", action="store_true", help="within a few minutes (default)")
    length.add_argument("--full", action="store_true", help="everything, an hour or so")


def _measuring(default: str = "") -> Option:
    """Options of what measures sections of the report."""
    words = "directory for the report; what is measured is kept there and found again"
    return group(option("-o", "--out", metavar="DIR", help=words + default), _length, OUTPUT)


@command(
    "report", "all parts: report.html, and report.json beside it",
    option(
        "scenes", metavar="SCENE", nargs="*",
        help="only what accuracy and effects cost, in these scenes: packaged names, or TOML files",
    ),
    option(
        "--overview", action="store_true",
        help="only what accuracy and effects cost, in the packaged damper and in a compression; "
        "printed, and written where -o says so",
    ),
    CHANGES,
    _measuring(f" ({REPORT} if not given)"),
    examples="""\
examples:
  %(prog)s damper --quick                # what accuracy and effects cost in one scene
  %(prog)s mine.toml bed -o out/mine
  %(prog)s --full -o out/validation      # goes on where it was stopped""",
)  # fmt: skip
def report(options: Any) -> None:
    """Measure all sections, the overview alone, or scenes of the user's own."""
    from granular.scene.loading import load_scene

    changes = changes_from(options.changes)
    if changes and not options.scenes:
        raise InputError("--set changes a scene; name one, such as: report damper")
    if options.overview:
        if options.scenes:
            raise InputError("--overview is of the packaged scenes; leave it or the scenes out")
        _measure(options, ("glance",), options.out)
        return
    scenes = [load_scene(one).replace(**changes) for one in options.scenes]
    _measure(options, (), options.out or REPORT, scenes)


def _section(name: str, summary: str, *options: Option, examples: str = "") -> Command:
    """A command that measures one section of the report."""
    return command(
        name, summary, *options, _measuring(), examples=examples or "example:\n  %(prog)s --quick"
    )(lambda chosen: _measure(chosen, (_section_name(chosen),), chosen.out))


def _section_name(options: Any) -> str:
    return "source-experiment" if getattr(options, "depaula", False) else options.command


def _measure(options: Any, names: tuple[str, ...], out: str | None, scenes: Any = ()) -> None:
    from validation.parts import measured
    from validation.programme import part_named
    from validation.report import ALL, report, summary

    progress = not options.quiet
    if out is not None:
        found = report(out, full=options.full, parts=names or ALL, scenes=scenes, progress=progress)
    else:
        results = {
            name: measured(part_named(name), None, full=options.full, progress=progress)
            for name in names
        }
        found = summary(results) | {"parts": results}
    emit(found, _text(found, out), options.json)


def _text(found: dict[str, Any], out: str | None) -> str:
    from validation.report import part_text

    lines = [part_text(name, results) for name, results in found["parts"].items()]
    lines += [f"{name}: {verdict}" for name, verdict in found["verdicts"].items()]
    if out is not None:
        lines.append(f"report: {out}/report.html")
    return "\n".join(lines)


@command(
    "method", "methods of your own: order, energy, and error against wall time",
    option("names", metavar="NAME", nargs="+", help="of a method, also of a built-in one"),
    IMPORT,
    option("--scene", help="measure errors over wall time on it: a name, or a TOML file"),
    CHANGES,
    option(
        "--quantity", dest="quantities", metavar="Q", action="append",
        help="what the error is in, such as energy or 'rest height' (repeatable)",
    ),
    UNTIL,
    option(
        "-o", "--out", metavar="DIR", default=METHOD_REPORT,
        help=f"directory for the report ({METHOD_REPORT} if not given)",
    ),
    OUTPUT,
    examples="""\
example:
  %(prog)s mclachlan-2 --import mine.py --scene bed.toml --quantity energy

mine.py:
  from granular import Method
  z = 0.1931833275037836
  method = Method("mclachlan-2", 2, kicks=(0, 0.5, 0.5, 0), drifts=(z, 1 - 2*z, z))""",
)  # fmt: skip
def method(options: Any) -> None:
    """Measure methods of the user's own."""
    from granular.own import import_own
    from validation.own_method import method_report

    import_own(options.own_files)
    if options.scene is None and options.changes:
        raise InputError("--set changes a scene; give one by --scene")
    found = method_report(
        options.out, options.names, scene=options.scene and scene_of(options),
        quantities=options.quantities, until=options.t_end, progress=not options.quiet,
    )  # fmt: skip
    emit(found, _text(found, options.out), options.json)


@command(
    "cheapest", "the setting that reaches a tolerance in the least time",
    SCENE, CHANGES,
    option("quantity", help="such as energy, positions, 'rest height', period"),
    option("tolerance", type=in_unit("1"), help="error that is allowed, such as 0.01 or '1 %%'"),
    UNTIL, OUTPUT,
    examples="example:\n  %(prog)s damper 'rest height' 0.01",
)  # fmt: skip
def cheapest(options: Any) -> None:
    """Recommend how to run a scene."""
    from validation.choice import cheapest as recommend

    choice = recommend(
        scene_of(options), options.quantity, options.tolerance, until=options.t_end,
        progress=not options.quiet,
    )  # fmt: skip
    emit(choice.to_plain(), str(choice), options.json)


DEPAULA = option(
    "--depaula", action="store_true",
    help="instead, de Paula's test of its method, with and without rounding",
)  # fmt: skip

PROGRAM = Program(
    "python -m validation",
    "Prove the toolkit's numbers.",
    """\
how far to trust it, and what accuracy costs:
  %(prog)s report
  %(prog)s cheapest damper "rest height" 0.01""",
    (
        report,
        _section(
            "convergence", "orders of convergence against exact solutions", DEPAULA,
            examples="examples:\n  %(prog)s --quick\n  %(prog)s --depaula --quick",
        ),
        _section("energy", "energy over long runs, tested for trends"),
        _section("work-precision", "error against wall time"),
        _section("stability", "the catalogue of hard cases"),
        method, cheapest,
    ),
)  # fmt: skip
parser, main = PROGRAM.parser, PROGRAM.main

if __name__ == "__main__":
    sys.exit(launch(main))
