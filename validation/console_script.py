"""The command ``granular-damper``: the commands of all three packages under one name.

The command is in this package because only this package may import the other two.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from granular.commands.console import (
    Parser,
    Program,
    add_version_option,
    command,
    command_registry,
    print_result,
    run_command_and_return_exit_code,
)
from granular.commands.options import OutputOptions
from granular.commands.signature import Option, add_options
from granular.shared.errors import InputError, unknown_word_message

PROG = "granular-damper"

_PACKAGES = {
    "granular": "beds and runs",
    "reduced_models": "from a motion to its equation of motion",
    "validation": "checks of accuracy",
}

_FORMER = {
    "methods": "scenes --methods",
    "warm-up": "scenes --warm-up",
    "impulse": "response --impulse",
    "laws": "fit --laws",
    "response-law": "compare --response",
    "glance": "report --overview",
    "source-experiment": "convergence --depaula",
}
"""Former commands, each with the command and option that now replace it."""

_VALIDATE = "validate"
"""Name of the command ``report`` of `validation`, and prefix of the other commands of `validation`."""

_FIRST = ("identify", "look", "fit", "design", "run", "render", "sweep", "response")
"""Commands that are listed if ``granular-damper`` is called without a command."""


def main() -> int:
    """Run ``granular-damper`` on the arguments of the process."""
    return run_command_and_return_exit_code(dispatch_command)


def dispatch_command(arguments: Sequence[str]) -> None:
    """Pass a command to the package that defines it."""
    programs = _load_programs()
    if not arguments:
        print(_first_commands_text(programs))
        return
    if arguments[0].startswith("-"):
        parser = Parser(
            prog=PROG,
            usage=f"{PROG} [-h] [--version] COMMAND ...",
            description="Simulate beds of repelling magnets, and identify equations of motion.",
            epilog=_all_commands_text(programs),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        add_version_option(parser)
        parser.add_argument("command", metavar="COMMAND", help=f"see {PROG} COMMAND --help")
        parser.parse_args(arguments)
    command, *words = arguments
    if command in _FORMER:
        raise InputError(f"'{command}' is not a command; did you mean '{_FORMER[command]}'?")
    if command == _VALIDATE:
        program = programs["validation"]
        if words and words[0] in program.commands:
            program.main(words, f"{PROG} {_VALIDATE}")
            return
        report = command_registry("", {_VALIDATE: program.commands["report"]})
        program._replace(commands=report).main(arguments, PROG)
        return
    homes = _programs_of_commands(programs)
    if command not in homes:
        raise InputError(
            f"{unknown_word_message(command, (*homes, _VALIDATE), 'command')} (see {PROG} --help)"
        )
    programs[homes[command]].main(arguments, PROG)


def _load_programs() -> dict[str, Program]:
    modules = {name: importlib.import_module(f"{name}.__main__") for name in _PACKAGES}
    return {name: module.PROGRAM for name, module in modules.items()} | {PROG: OWN}


def _programs_of_commands(programs: dict[str, Program]) -> dict[str, str]:
    """Return the program of each command; built-in commands take precedence over commands of packages."""
    homes: dict[str, str] = {}
    for package, program in programs.items():
        homes = dict.fromkeys(program.commands, package) | homes
    for package, program in programs.items():
        homes |= dict.fromkeys(program.commands.built_in, package)
    return homes


def _first_commands_text(programs: dict[str, Program]) -> str:
    """Return a list of eight commands for beginners, as a string with one line for each."""
    summaries = {
        name: words
        for program in programs.values()
        for name, words in program.commands.descriptions().items()
        if name in program.commands.built_in
    }
    lines = [f"  {name:10}{summaries[name]}" for name in _FIRST if name in summaries]
    return "\n".join([f"{PROG} COMMAND ...", "", *lines, "", f"all commands: {PROG} --help"])


def _all_commands_text(programs: dict[str, Program]) -> str:
    titles = {name: f"{title} (also python -m {name}):" for name, title in _PACKAGES.items()}
    lines, homes = [], _programs_of_commands(programs)
    for package, program in programs.items():
        lines.append(titles.get(package, "about the toolkit:"))
        for name, summary in program.commands.descriptions().items():
            if homes[name] != package:
                continue
            lines.append(f"  {_VALIDATE if name == 'report' else name:18}{summary}")
        lines.append("")
    return "\n".join([*lines, f"example:\n  {PROG} identify damper -o out"])


@command("examples:\n  %(prog)s\n  %(prog)s damper blanes-moan-4 van-der-pol-like > used.bib")
def cite(
    things: Annotated[tuple[str, ...], Option("scene, run, method, law or model.json", "THING")] = (),
    *,
    output: OutputOptions,
) -> None:
    """Print the papers behind scenes, runs, methods, laws and models, as BibTeX."""
    from granular.shared.citations import cite as bibtex

    text = bibtex(*map(_resolve_cited_name, things))
    print_result({"bibtex": text}, text, output.json)


def _resolve_cited_name(name: str) -> Any:
    """Return the scene, run, method, law or model that a name or a path refers to."""
    from granular import load_scene, load_trajectory
    from granular.methods import METHODS, method_named
    from granular.scene.named_scenes import scene_names
    from reduced_models import load_model
    from reduced_models.laws.catalogue import LAWS, law_named

    path = Path(name)
    if path.is_dir():
        return load_trajectory(path)
    if path.suffix == ".json":
        return load_model(path)
    if name.partition("+")[0] in METHODS:
        return method_named(name)
    if name in LAWS:
        return law_named(name)
    if path.suffix == ".toml" or name in scene_names():
        return load_scene(name)
    raise InputError(unknown_word_message(name, (*scene_names(), *METHODS, *LAWS), "scene, method or law"))


@command("""\
examples:
  eval "$(%(prog)s bash)"                                        # in ~/.bashrc
  %(prog)s fish > ~/.config/fish/completions/granular-damper.fish""")
def completion(
    shell: Annotated[Literal["bash", "zsh", "fish"], Option("shell that will complete the commands")],
) -> None:
    """Print a script that makes a shell complete commands and options."""
    try:
        import shtab
    except ImportError:
        raise InputError("completion needs shtab: pip install 'granular-damper[completion]'") from None
    top = Parser(prog=PROG)
    add_version_option(top)
    parsers = top.add_subparsers(metavar="COMMAND")
    for program in _load_programs().values():
        for name, offered in program.commands.usable_parts().items():
            add_options(parsers.add_parser(name, help=offered.summary), offered.carry_out)
    print(shtab.complete(top, shell=shell))


OWN = Program(PROG, "About the toolkit.", "", command_registry("", {"cite": cite, "completion": completion}))
"""Commands that belong to none of the packages."""
