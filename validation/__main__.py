"""Command line of the validation: ``python -m validation``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from granular.commands.console import (
    Parser,
    add_changes,
    add_import,
    add_output,
    add_scene,
    changes_from,
    command_parser,
    emit,
    in_unit,
    launch,
)
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from granular.scene.scene import Scene

PROG = "python -m validation"

REPORT = "out/validation"
"""Directory of the report where none is given."""

METHOD_REPORT = "out/method"
"""The same, of a user's own methods."""

_PARTS = {
    "glance": "what accuracy and effects cost in the packaged damper and in a compression",
    "convergence": "orders of convergence against exact solutions",
    "source-experiment": "de Paula's test of its method, with and without rounding",
    "energy": "energy over long runs, tested for trends",
    "work-precision": "error against wall time",
    "stability": "the catalogue of hard cases",
}

_EXAMPLES = {
    "": """\
how far to trust it, and what accuracy costs:
  %(prog)s report
  %(prog)s cheapest damper "rest height" 0.01""",
    "report": """\
examples:
  %(prog)s damper --quick                # what accuracy and effects cost in one scene
  %(prog)s mine.toml bed -o out/mine
  %(prog)s --full -o out/validation      # goes on where it was stopped""",
    **dict.fromkeys(_PARTS, "example:\n  %(prog)s --quick"),
    "method": """\
example:
  %(prog)s mclachlan-2 --import mine.py --scene bed.toml --quantity energy

mine.py:
  from granular import Method
  z = 0.1931833275037836
  method = Method("mclachlan-2", 2, kicks=(0, 0.5, 0.5, 0), drifts=(z, 1 - 2*z, z))""",
    "cheapest": "example:\n  %(prog)s damper 'rest height' 0.01",
}


def parser(prog: str = PROG) -> Parser:
    """The command line's grammar; ``prog`` is what the user types before a command."""
    top, add = command_parser(prog, "Prove the toolkit's numbers.", _EXAMPLES)
    whole = add("report", "all parts: report.html, and report.json beside it")
    whole.add_argument(
        "scenes", metavar="SCENE", nargs="*",
        help="only what accuracy and effects cost, in these scenes: packaged names, or TOML files",
    )  # fmt: skip
    add_changes(whole)
    _add_measuring(whole, REPORT)
    for name, words in _PARTS.items():
        _add_measuring(add(name, words), None)
    _add_method(add("method", "methods of your own: order, energy, and error against wall time"))
    one = add("cheapest", "the setting that reaches a tolerance in the least time")
    add_scene(one)
    one.add_argument("quantity", help="such as energy, positions, 'rest height', period")
    one.add_argument(
        "tolerance", type=in_unit("1"), help="error that is allowed, such as 0.01 or '1 %%'"
    )
    one.add_argument(
        "--t-end", type=in_unit("s"), metavar="T", help="stop each run at this time [s]"
    )
    add_output(one)
    return top


def _add_method(one: argparse.ArgumentParser) -> None:
    one.add_argument("names", metavar="NAME", nargs="+", help="of a method, also of a built-in one")
    add_import(one)
    one.add_argument("--scene", help="measure errors over wall time on it: a name, or a TOML file")
    add_changes(one)
    one.add_argument(
        "--quantity", dest="quantities", metavar="Q", action="append",
        help="what the error is in, such as energy or 'rest height' (repeatable)",
    )  # fmt: skip
    one.add_argument(
        "--t-end", type=in_unit("s"), metavar="T", help="stop runs of the scene there [s]"
    )
    one.add_argument(
        "-o", "--out", metavar="DIR", default=METHOD_REPORT,
        help=f"directory for the report ({METHOD_REPORT} if not given)",
    )  # fmt: skip
    add_output(one)


def _add_measuring(one: argparse.ArgumentParser, out: str | None) -> None:
    where = f" ({out} if not given)" if out else ""
    one.add_argument(
        "-o", "--out", metavar="DIR", default=out,
        help=f"directory for the report; what is measured is kept there and found again{where}",
    )  # fmt: skip
    length = one.add_mutually_exclusive_group()
    length.add_argument("--quick", action="store_true", help="within a few minutes (default)")
    length.add_argument("--full", action="store_true", help="everything, an hour or so")
    add_output(one)


def main(arguments: Sequence[str], prog: str = PROG) -> None:
    """Run one command."""
    options = parser(prog).parse_args(arguments)
    if options.command == "cheapest":
        _cheapest(options)
    elif options.command == "method":
        _method(options)
    else:
        _measure(options)


def _measure(options: Any) -> None:
    from validation.parts import measured
    from validation.programme import part_named
    from validation.report import report, summary

    names = tuple(_PARTS) if options.command == "report" else (options.command,)
    progress = not options.quiet
    if options.out is not None:
        found = report(
            options.out, full=options.full, parts=names, scenes=_scenes(options), progress=progress
        )
    else:
        part = part_named(options.command)
        results = {part.name: measured(part, None, full=options.full, progress=progress)}
        found = summary(results) | {"parts": results}
    emit(found, _text(found, options.out), options.json)


def _scenes(options: Any) -> list[Scene]:
    """The scenes that a report is asked for."""
    from granular.scene.loading import load_scene

    if options.command != "report":
        return []
    changes = changes_from(options.changes)
    if changes and not options.scenes:
        raise InputError("--set changes a scene; name one, such as: report damper")
    return [load_scene(one).replace(**changes) for one in options.scenes]


def _text(found: dict[str, Any], out: str | None) -> str:
    from validation.report import part_text

    lines = [part_text(name, results) for name, results in found["parts"].items()]
    lines += [f"{name}: {verdict}" for name, verdict in found["verdicts"].items()]
    if out is not None:
        lines.append(f"report: {out}/report.html")
    return "\n".join(lines)


def _method(options: Any) -> None:
    from granular.own import import_own
    from granular.scene.loading import load_scene
    from validation.own_method import method_report

    import_own(options.own_files)
    changes = changes_from(options.changes)
    if options.scene is None and changes:
        raise InputError("--set changes a scene; give one by --scene")
    scene = None if options.scene is None else load_scene(options.scene).replace(**changes)
    found = method_report(
        options.out, options.names, scene=scene, quantities=options.quantities,
        until=options.t_end, progress=not options.quiet,
    )  # fmt: skip
    emit(found, _text(found, options.out), options.json)


def _cheapest(options: Any) -> None:
    from granular.scene.loading import load_scene
    from validation.choice import cheapest

    changes = changes_from(options.changes)
    scene = load_scene(options.scene).replace(**changes)
    choice = cheapest(
        scene, options.quantity, options.tolerance, until=options.t_end, progress=True
    )
    emit(choice.to_plain(), str(choice), options.json)


if __name__ == "__main__":
    sys.exit(launch(main))
