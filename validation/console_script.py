"""The command ``granular-damper``: the commands of all three packages under one name.

It lives here because imports go in one direction, and only this package knows the other two.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Sequence
from types import ModuleType

from granular.commands.console import Parser, add_version_option, launch
from granular.schema.sections import unknown
from granular.shared.errors import InputError

PROG = "granular-damper"

_PACKAGES = {
    "granular": "beds and runs",
    "reduced_models": "from a motion to its equation",
    "validation": "proof of the numbers",
}

_FORMER = {
    "methods": "scenes --methods", "warm-up": "scenes --warm-up",
    "impulse": "response --impulse", "laws": "fit --laws", "response-law": "compare --response",
    "maps": "design --maps", "glance": "report --overview",
    "source-experiment": "convergence --depaula",
}  # fmt: skip
"""Commands that are options of others now."""

_VALIDATE = "validate"
"""Name of the validation's ``report``, which would not say of what next to other commands."""


def main() -> int:
    """Run the command line; its exit code."""
    return launch(run)


def run(arguments: Sequence[str]) -> None:
    """Hand the command to the package that has it.

    Raises
    ------
    InputError
        If no package has it; the nearest name is given.
    """
    modules = {name: importlib.import_module(f"{name}.__main__") for name in _PACKAGES}
    homes = {
        command: package
        for package, module in modules.items()
        for command in module.parser().commands
    }
    homes[_VALIDATE] = "validation"
    if not arguments or arguments[0].startswith("-"):
        _top_parser(modules).parse_args(arguments)
    command, *words = arguments
    if command in _FORMER:
        raise InputError(f"there is no command '{command}'; did you mean '{_FORMER[command]}'?")
    if command not in homes:
        raise InputError(f"{unknown(command, tuple(homes), 'command')} (see {PROG} --help)")
    name = "report" if command == _VALIDATE else command
    modules[homes[command]].main([name, *words], PROG)


def _top_parser(modules: dict[str, ModuleType]) -> Parser:
    """Parser that answers where no command is given."""
    parser = Parser(
        prog=PROG,
        usage=f"{PROG} [-h] [--version] COMMAND ...",
        description="Simulate beds of repelling magnets, find the equation of the damper that they "
        "make, and prove the numbers.",
        epilog=_listing(modules),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_version_option(parser)
    parser.add_argument("command", metavar="COMMAND", help=f"see {PROG} COMMAND --help")
    return parser


def _listing(modules: dict[str, ModuleType]) -> str:
    lines = []
    for package, title in _PACKAGES.items():
        lines += [f"{title} (also python -m {package}):"]
        for command, what in modules[package].parser().commands.items():
            name = _VALIDATE if (package, command) == ("validation", "report") else command
            lines.append(f"  {name:18}{what}")
        lines.append("")
    return "\n".join([*lines, f"example:\n  {PROG} identify damper -o out"])
