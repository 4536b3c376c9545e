"""Command line of the validation: ``python -m validation``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from granular.commands.console import (
    Command,
    Option,
    Program,
    command,
    launch,
    option,
    option_group,
    print_result,
    refuse_options,
)
from granular.commands.options import (
    CHANGES,
    IMPORT,
    OUTPUT,
    SCENE,
    parse_changes,
    quantity_reader,
    scene_from_options,
)
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from validation.report_tasks import Section

REPORT = "out/validation"
"""Directory of the report where none is given."""

METHOD_REPORT = "out/method"
"""The same, of a user's own methods."""

UNTIL = option("--t-end", type=quantity_reader("s"), metavar="T", help="stop each run at this time [s]")


def _full_or_quick_option(parser: argparse._ActionsContainer) -> None:
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--quick", action="store_true", help="within a few minutes (default)")
    length.add_argument("--full", action="store_true", help="everything, an hour or so")


def _measuring_options(default: str = "") -> Option:
    """Options of what measures sections of the report."""
    words = "directory for the report; what is measured is kept there and found again"
    return option_group(
        option("-o", "--out", metavar="DIR", help=words + default), _full_or_quick_option, OUTPUT
    )


@command(
    "report",
    "all parts: report.html, and report.json next to it",
    option(
        "scenes",
        metavar="SCENE",
        nargs="*",
        help="only what accuracy and effects cost, in these scenes: packaged names, or TOML files",
    ),
    option(
        "--overview",
        action="store_true",
        help="only what accuracy and effects cost, in the packaged damper and in a compression; "
        "printed, and written where -o says so",
    ),
    CHANGES,
    IMPORT,
    _measuring_options(f" ({REPORT} if not given)"),
    examples="""\
examples:
  %(prog)s damper --quick                # what accuracy and effects cost in one scene
  %(prog)s mine.toml bed -o out/mine
  %(prog)s --full -o out/validation      # goes on where it was stopped""",
)
def measure_report(options: Any) -> None:
    """Measure all sections, the overview alone, or scenes of the user's own."""
    from granular.scene.loading import load_scene
    from granular.user_code import import_user_code
    from validation.overview import OVERVIEW, overview_section_for
    from validation.report import SECTIONS

    import_user_code(options.user_files)
    changes = parse_changes(options.changes)
    if changes and not options.scenes:
        raise InputError(f"--set changes a scene; name one, such as: {options.prog} damper")
    if options.overview:
        refuse_options(options, "--overview, which is of packaged scenes", scenes="SCENE")
        _measure_sections(options, [OVERVIEW], options.out)
    elif options.scenes:
        scenes = [load_scene(scene).replace(**changes) for scene in options.scenes]
        _measure_sections(options, [overview_section_for(scenes)], options.out or REPORT)
    else:
        _measure_sections(options, SECTIONS.values(), options.out or REPORT)


def _section_command(name: str, summary: str, *options: Option, examples: str = "") -> Command:
    """Command that measures one section of the report."""

    def carry_out(chosen: Any) -> None:
        from validation.report import SECTIONS

        wanted = "depaula" if getattr(chosen, "depaula", False) else name
        _measure_sections(chosen, [SECTIONS[wanted]], chosen.out)

    examples = examples or "example:\n  %(prog)s --quick"
    return command(name, summary, *options, _measuring_options(), examples=examples)(carry_out)


def _measure_sections(options: Any, sections: Iterable[Section], out: str | None) -> None:
    from validation.report import report as measure

    _show_sections(measure(out, tuple(sections), full=options.full, progress=not options.quiet), out, options)


def _show_sections(result: dict[str, Any], out: str | None, options: Any) -> None:
    from validation.report import report_text

    text = report_text(result)
    if out is not None:
        text += f"\nreport: {out}/report.html"
    print_result(result, text, options.json)


@command(
    "method",
    "methods of your own: order, energy, and error against wall time",
    option("names", metavar="NAME", nargs="+", help="of a method, also of a built-in one"),
    IMPORT,
    option("--scene", help="measure errors over wall time on it: a name, or a TOML file"),
    CHANGES,
    option(
        "--quantity",
        dest="quantities",
        metavar="Q",
        action="append",
        help="what the error is in, such as energy or 'rest height' (repeatable)",
    ),
    UNTIL,
    option(
        "-o",
        "--out",
        metavar="DIR",
        default=METHOD_REPORT,
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
)
def measure_own_methods(options: Any) -> None:
    """Measure methods of the user's own."""
    from granular.user_code import import_user_code
    from validation.report import method_report

    import_user_code(options.user_files)
    if options.scene is None and options.changes:
        raise InputError("--set changes a scene; give one by --scene")
    result = method_report(
        options.out,
        options.names,
        scene=options.scene and scene_from_options(options),
        quantities=options.quantities,
        until=options.t_end,
        progress=not options.quiet,
    )
    _show_sections(result, options.out, options)


@command(
    "cheapest",
    "the setting that reaches a tolerance in the least time",
    SCENE,
    CHANGES,
    IMPORT,
    option("quantity", help="such as energy, positions, 'rest height', period"),
    option("tolerance", type=quantity_reader("1"), help="error that is allowed, such as 0.01 or '1 %%'"),
    UNTIL,
    OUTPUT,
    examples="example:\n  %(prog)s damper 'rest height' 0.01",
)
def print_recommendation(options: Any) -> None:
    """Recommend how to run a scene."""
    from validation.recommendation import recommend_settings

    result = recommend_settings(
        scene_from_options(options),
        options.quantity,
        options.tolerance,
        until=options.t_end,
        progress=not options.quiet,
    )
    print_result(result.to_plain(), str(result), options.json)


DEPAULA = option(
    "--depaula", action="store_true", help="instead, de Paula's test of its method, with and without rounding"
)

PROGRAM = Program(
    "python -m validation",
    "Prove the toolkit's numbers.",
    """\
how far to trust it, and what accuracy costs:
  %(prog)s report
  %(prog)s cheapest damper "rest height" 0.01""",
    (
        measure_report,
        _section_command(
            "convergence",
            "orders of convergence against exact solutions",
            DEPAULA,
            examples="examples:\n  %(prog)s --quick\n  %(prog)s --depaula --quick",
        ),
        _section_command("energy", "energy over long runs, tested for trends"),
        _section_command("work-precision", "error against wall time"),
        _section_command("stability", "the catalogue of hard cases"),
        measure_own_methods,
        print_recommendation,
    ),
)
parser, main = PROGRAM.parser, PROGRAM.main

if __name__ == "__main__":
    sys.exit(launch(main))
