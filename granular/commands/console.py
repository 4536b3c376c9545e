"""What the three packages' command lines share.

Every command exits with 0, or prints one line on standard error that names the value, the limit
and the remedy: 2 for bad input, 1 for a run that could not be finished, 130 after Ctrl-C, 143 after
SIGTERM, which ends a command in the same way.
"""

from __future__ import annotations

import argparse
import io
import json
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn

from granular.shared.errors import GranularError, InputError, Interrupted, Terminated
from granular.shared.files import finite
from granular.shared.messages import one_line, printable, quoted
from granular.shared.missing import missing
from granular.shared.stops import taking_sigterm
from granular.shared.surroundings import check_surroundings
from granular.shared.toml import parse_toml
from granular.shared.version import __version__

BAD_INPUT, FAILED, INTERRUPTED, TERMINATED = 2, 1, 130, 143


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line.

    Attributes
    ----------
    commands : dict of str to str
        What each command does, by its name.
    """

    commands: dict[str, str]

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message}; see {self.prog} --help")


def launch(command: Callable[[Sequence[str]], None], arguments: Sequence[str] | None = None) -> int:
    """Run a command; its exit code."""
    warnings.showwarning = _show_warning
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # where the terminal knows no µ
    try:
        check_surroundings()
        with taking_sigterm():
            command(sys.argv[1:] if arguments is None else arguments)
    except InputError as error:
        return _complain(str(error), BAD_INPUT)
    except GranularError as error:
        return _complain(str(error), FAILED)
    except Interrupted as stop:
        path = getattr(stop.trajectory, "path", None)
        kept = f"what was done is in {path}; --resume goes on" if path else "nothing was written"
        return _complain(f"{stop}: {kept}", TERMINATED if stop.terminated else INTERRUPTED)
    except Terminated:
        return _complain("terminated", TERMINATED)
    except ModuleNotFoundError as error:
        advice = missing(error)
        if advice is None:
            raise
        return _complain(str(advice), BAD_INPUT)
    except KeyboardInterrupt:
        return _complain("interrupted", INTERRUPTED)
    except Warning as warning:  # where Python was told to take warnings for errors
        return _complain(f"warning taken for an error: {warning}", FAILED)
    except BrokenPipeError:
        sys.stderr.close()  # the reader went away; nothing is left to say
        return 0
    return 0


def _complain(message: str, code: int) -> int:
    print(f"error: {one_line(message)}", file=sys.stderr)
    return code


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    print(f"warning: {one_line(message)}", file=sys.stderr)


def command_parser(
    prog: str, description: str, examples: Mapping[str, str]
) -> tuple[Parser, Callable[[str, str], Parser]]:
    """A parser of commands, and what adds a command by its name and what it does.

    ``examples`` holds texts by command that stand at the end of its help; those of the whole under
    the empty name. ``%(prog)s`` in them is what the user types.
    """
    top = Parser(
        prog=prog,
        description=description,
        epilog=examples[""],
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_version(top)
    top.commands = {}
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def add(name: str, what: str) -> Parser:
        top.commands[name] = what
        one: Parser = commands.add_parser(
            name,
            help=what,
            description=what[0].upper() + what[1:] + ".",
            epilog=examples[name],
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        return one

    return top, add


def add_version(parser: argparse.ArgumentParser) -> None:
    """The toolkit's version, on request."""
    parser.add_argument(
        "--version", action="version", version=f"granular-damper {__version__}",
        help="print the version and exit",
    )  # fmt: skip


def emit(result: dict[str, Any], text: str, as_json: bool) -> None:
    """Print a result: one JSON object, or a text for people.

    JSON has neither infinities nor NaN: they are printed as null.
    """
    print(json.dumps(finite(result), allow_nan=False) if as_json else printable(text))


def add_scene(parser: argparse.ArgumentParser, name: str = "scene", what: str = "") -> None:
    """The scene and changes to it."""
    what = what or "name of a packaged scene, or path to a TOML file"
    parser.add_argument(name, metavar=name.upper(), help=what)
    add_changes(parser)


def add_changes(parser: argparse.ArgumentParser) -> None:
    """Changes to a scene."""
    parser.add_argument(
        "--set",
        dest="changes",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="change the scene: dotted key and value, such as piston.mass=6.5 or "
        "'effects.drag.coefficient=0.2 kg/s'; 'none' takes a part away (repeatable)",
    )


def add_run(parser: argparse.ArgumentParser) -> None:
    """How a scene is run."""
    parser.add_argument(
        "--dt", default="auto", help="time step [s], 'auto' (default), or a multiple such as auto/2"
    )
    parser.add_argument("--method", default="stormer-verlet",
        help="integration method, by name (stormer-verlet); 'granular methods' lists them",
    )  # fmt: skip
    add_import(parser)
    parser.add_argument("--threads", type=int,
        help="number of threads; the result is the same to the last bit with any number",
    )  # fmt: skip


def add_accuracy(parser: argparse.ArgumentParser) -> None:
    """An accuracy instead of a step and a method."""
    parser.add_argument(
        "--accuracy", metavar="TEXT",
        help="choose dt, method and sum over pairs for this error, such as '1e-3 rest height'",
    )  # fmt: skip


def add_import(parser: argparse.ArgumentParser) -> None:
    """Code of the user's own."""
    parser.add_argument(
        "--import", dest="own_files", metavar="FILE", action="append", default=[],
        help="run this Python file of yours first: its effects, methods and measures are then "
        "known by their names (repeatable)",
    )  # fmt: skip


def add_output(parser: argparse.ArgumentParser) -> None:
    """How a command speaks."""
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def changes_from(items: Sequence[str]) -> dict[str, Any]:
    """Changes to a scene from ``KEY=VALUE`` texts.

    Raises
    ------
    InputError
        If a text has no equals sign.
    """
    changes: dict[str, Any] = {}
    for item in items:
        key, equals, value = item.partition("=")
        if not equals or not key.strip():
            raise InputError(
                f"--set {quoted(item)} is not KEY=VALUE; write for instance piston.mass=6.5"
            )
        try:
            changes[key.strip()] = parse_toml(f"value = {value}")["value"]
        except ValueError:
            changes[key.strip()] = value.strip()
    return changes


def in_unit(unit: str) -> Callable[[str], float]:
    """What reads an option: a number in that SI unit, or a quantity with a unit of its own."""

    def read(text: str) -> float:
        from granular.schema.units import si_value

        try:
            return si_value(text, unit)
        except GranularError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return read


def time_step(text: str) -> float | str:
    """A time step from the command line: seconds, a quantity, or a multiple of "auto".

    Raises
    ------
    InputError
        If it is none of these.
    """
    from granular.schema.units import si_value

    return text if text.startswith("auto") else si_value(text, "s")
