r"""Command lines of the three packages.

A command is a function: its signature defines the options (see `granular.commands.signature`), its
docstring is the summary, and the decorator `command` takes the examples. Options that several commands have
are defined once, in `granular.commands.options`. Slow imports are inside the function, so that ``--help``
is fast.

    @command(examples="example:\n  %(prog)s damper --set piston.mass=6.5")
    def show(scene: SceneName, *, changes: SceneChangeOptions, output: OutputOptions) -> None:
        'Describe a scene, in SI and in natural units.'
        loaded = changes.load(scene)
        print_result(derived_scene_values(loaded), scene_text(loaded), output.json)

A package's ``__main__`` lists its commands in the registry of a `Program`.

Every command exits with 0, or prints one line on standard error with the value, the limit and the
remedy. Exit codes are 2 for bad input, 1 for a run that failed, 130 after Ctrl-C, and 143 after
SIGTERM, which ends a command like Ctrl-C.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import inspect
import io
import json
import os
import sys
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextvars import ContextVar
from typing import Any, NamedTuple, NoReturn, TextIO

from granular.commands.signature import add_options, collect_arguments_from_options
from granular.shared.blocks import Block, print_blocks, wrap
from granular.shared.errors import (
    GranularError,
    InputError,
    Interrupted,
    Terminated,
    missing_package_error,
    one_line,
    printable,
    sanitize,
    unknown_word_message,
)
from granular.shared.files import replace_non_finite_by_none
from granular.shared.garbage import rare_garbage_collection
from granular.shared.registry import Registry
from granular.shared.stop_signals import handle_sigterm
from granular.shared.version import __version__, store_command_line

__all__ = ["Command", "command", "print_result"]

# As in argparse and shells: 128 plus the number of the signal, SIGINT or SIGTERM.
BAD_INPUT, FAILED, INTERRUPTED, TERMINATED = 2, 1, 130, 143


_PROGRAM: ContextVar[str] = ContextVar("program", default="")


class Parser(argparse.ArgumentParser):
    """An argument parser with one-line errors."""

    commands: dict[str, str]
    parsers: dict[str, Parser]

    def error(self, message: str) -> NoReturn:
        """Raise a usage error as one line."""
        raise InputError(f"{message}; see {self.prog} --help")


def run_command_and_return_exit_code(
    command: Callable[[Sequence[str]], None], arguments: Sequence[str] | None = None
) -> int:
    """Run a command, print each error and warning on one line, and return the exit code."""
    warnings.showwarning = _show_warning
    # Trial parameters of a search may overflow; they are rejected afterwards.
    warnings.filterwarnings("ignore", r".* encountered in ", RuntimeWarning)
    sys.stdout, sys.stderr = (
        sys.stdout or _open_null_stream(),
        sys.stderr or _open_null_stream(),
    )  # closed by the caller
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # for terminals that cannot print µ
    try:
        _check_directory_and_thread_variable()
        with handle_sigterm(last=arguments is None), rare_garbage_collection():
            command(sys.argv[1:] if arguments is None else arguments)
            sys.stdout.flush()
        if arguments is None:
            gc.freeze()  # saves 2 s of garbage collection over compiled objects at exit
    except InputError as error:
        return _print_error_and_return_exit_code(str(error), BAD_INPUT)
    except GranularError as error:
        return _print_error_and_return_exit_code(str(error), FAILED)
    except ModuleNotFoundError as error:
        advice = missing_package_error(error)
        if advice is None:
            raise
        return _print_error_and_return_exit_code(str(advice), BAD_INPUT)
    except Warning as warning:  # if Python is set to turn warnings into errors
        return _print_error_and_return_exit_code(f"warning treated as an error: {warning}", FAILED)
    except BrokenPipeError:
        sys.stderr.close()  # the reader closed the pipe
        return 0
    except (KeyboardInterrupt, Exception) as error:
        ending = _message_and_exit_code_of_interruption(error)
        if ending is not None:
            return _print_error_and_return_exit_code(*ending)
        if not isinstance(error, OSError) or error.errno is None:
            raise
        return _print_error_and_return_exit_code(_explain_system_error(error), FAILED)
    return 0


def _message_and_exit_code_of_interruption(error: BaseException) -> tuple[str, int] | None:
    """Return the message and exit code if Ctrl-C or SIGTERM caused the error, even indirectly, or None."""
    waiting: list[BaseException | None] = [error]
    seen = set[BaseException]()
    while waiting:
        link = waiting.pop()
        if isinstance(link, KeyboardInterrupt):
            return _stop_message_and_exit_code(link)
        if link is not None and link not in seen:
            seen.add(link)
            waiting += [link.__cause__, link.__context__]
    return None


def _stop_message_and_exit_code(stop: KeyboardInterrupt) -> tuple[str, int]:
    """Return a message that says where results are stored, and the exit code for Ctrl-C or SIGTERM."""
    terminated = isinstance(stop, Terminated) or (isinstance(stop, Interrupted) and stop.terminated)
    word, code = ("terminated", TERMINATED) if terminated else ("interrupted", INTERRUPTED)
    saved = getattr(stop, "saved", "")
    path = getattr(getattr(stop, "trajectory", None), "path", None)
    if path is not None and not saved:
        saved = (
            f"the results so far are in {path}; to continue, repeat the command, "
            "and add --resume if it is the command run"
        )
    return f"{word}: {saved}" if saved else word, code


def _open_null_stream() -> TextIO:
    """Open a stream that discards all text written to it."""
    return open(os.devnull, "w", encoding="utf-8")


def _explain_system_error(error: OSError) -> str:
    """Explain an error of the operating system, such as a full disk."""
    if error.filename is None:
        with contextlib.suppress(OSError):  # buffered output would fail again at exit
            sys.stdout.close()
    target = "standard output or a file" if error.filename is None else sanitize(error.filename)
    return f"{target}: {error.strerror}; correct this, and try again"


def _print_error_and_return_exit_code(message: str, code: int) -> int:
    print(f"error: {one_line(message)}", file=sys.stderr)
    return code


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    print(f"warning: {one_line(message)}", file=sys.stderr)


class Command(NamedTuple):
    """A command of a program.

    Attributes
    ----------
    summary, examples : str
        Summary and examples in the help text.
    carry_out : function
        Function that carries out the command; its signature defines the options.
    """

    summary: str
    examples: str
    carry_out: Callable[..., None]


def command(examples: str) -> Callable[[Callable[..., None]], Command]:
    """Turn a function into a command of a program.

    Parameters
    ----------
    examples : str
        Text at the end of the help.

    Returns
    -------
    function
        Decorator that converts a function to a `Command`; the docstring is the summary.
    """

    def decorate(carry_out: Callable[..., None]) -> Command:
        words = inspect.getdoc(carry_out) or ""
        summary = words[:1].lower() + words[1:].rstrip(".")
        return Command(summary, examples, carry_out)

    return decorate


def command_registry(group: str, built_in: Mapping[str, Command | str]) -> Registry[Command]:
    """Make the registry of a program's commands, by name."""
    return Registry(
        "command",
        group,
        built_in,
        lambda _, offered: (
            isinstance(offered, Command) and bool(offered.summary) and _require_usable_command(offered)
        ),
        "made by granular.commands.console.command from a function with a docstring and typed options",
        lambda offered: offered.summary,
    )


def _require_usable_command(offered: Command) -> bool:
    """Return True if a parser can be made for a command; raise an error otherwise."""
    add_options(argparse.ArgumentParser(), offered.carry_out)
    return True


class Program(NamedTuple):
    """The command line of a package."""

    name: str
    description: str
    examples: str
    commands: Registry[Command]

    def parser(self, name: str | None = None) -> Parser:
        """Make the parser of the command line, with a subparser for each command."""
        raw = argparse.RawDescriptionHelpFormatter
        top = Parser(
            prog=name or self.name, description=self.description, epilog=self.examples, formatter_class=raw
        )
        add_version_option(top)
        top.commands, top.parsers = self.commands.descriptions(), {}
        parsers = top.add_subparsers(dest="command", required=True, metavar="COMMAND")
        working, errors = self.commands.load()
        for word, error in errors.items():
            parsers.add_parser(word, help=str(error).replace("%", "%%"))
        for word, offered in working.items():
            parser = parsers.add_parser(
                word,
                help=offered.summary.replace("%", "%%"),
                epilog=offered.examples,
                formatter_class=raw,
                description=f"{offered.summary[0].upper()}{offered.summary[1:]}.".replace("%", "%%"),
            )
            add_options(parser, offered.carry_out)
            top.parsers[word] = parser
        return top

    def main(self, arguments: Sequence[str], name: str | None = None) -> None:
        """Parse arguments, and run the command."""
        parser = self.parser(name)
        word = next(iter(arguments), "-")
        if word not in self.commands and not word.startswith("-"):
            message = unknown_word_message(word, tuple(self.commands), "command").rstrip("?")
            raise InputError(f"{message}; see {parser.prog} --help")
        options, rest = parser.parse_known_args(arguments)
        chosen = self.commands[options.command]
        if rest:
            raise InputError(_unknown_argument_message(rest, parser.parsers[options.command]))
        store_command_line(parser.prog, arguments)
        _PROGRAM.set(parser.parsers[options.command].prog)
        chosen.carry_out(**collect_arguments_from_options(chosen.carry_out, options))


def _unknown_argument_message(rest: Sequence[str], parser: argparse.ArgumentParser) -> str:
    """Return the message for unknown arguments of a command, with the most similar option."""
    option_names = [name for action in parser._actions for name in action.option_strings]
    unknown = next((word.split("=")[0] for word in rest if word.startswith("--")), None)
    words = f"unrecognized arguments: {' '.join(rest)}"
    if unknown is not None:
        words = unknown_word_message(unknown, option_names, "option").rstrip("?")
    return f"{words}; see {parser.prog} --help"


def current_program_and_command() -> str:
    """Return the names of the running program and command, for messages."""
    return _PROGRAM.get()


def given_options(**options: Any) -> dict[str, Any]:
    """Select the options that are not None, as keyword arguments of a function."""
    return {name: value for name, value in options.items() if value is not None}


def require_options(**options: Any) -> None:
    """Raise an error if an option that the command needs in its present use is missing (None or empty)."""
    missing = [_option_spelling(name) for name, value in options.items() if value in (None, ())]
    if missing:
        raise InputError(
            f"the following arguments are required: {', '.join(missing)}; see {_PROGRAM.get()} --help"
        )


def refuse_options(form: str, **options: Any) -> None:
    """Raise an error if an option is given that cannot be combined with ``form``, such as ``--impulse``."""
    for name, value in options.items():
        if value not in (None, (), False):
            raise InputError(f"{_option_spelling(name)} cannot be combined with {form}; remove one of them")


def _option_spelling(name: str) -> str:
    """Return the option for a parameter; keep names in capitals, and drop a final underscore."""
    return name if name.isupper() else f"--{name.rstrip('_').replace('_', '-')}"


def add_version_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--version``, which prints the toolkit's version and exits."""
    parser.add_argument(
        "--version",
        action="version",
        version=f"granular-damper {__version__}",
        help="print the version and exit",
    )


def print_result(result: dict[str, Any], shown: str | Iterable[Block], as_json: bool) -> None:
    """Print a result as one JSON object, or in readable form as blocks or wrapped text.

    Parameters
    ----------
    result : dict of str to Any
        Plain data; numbers that are not finite become null.
    shown : str or iterable of blocks
        The result in readable form.
    as_json : bool
        True to print the JSON object.
    """
    if as_json:
        print(json.dumps(replace_non_finite_by_none(result), allow_nan=False))
    elif isinstance(shown, str):
        print("\n".join(map(_wrap_note, printable(shown).split("\n"))))
    else:
        print_blocks(shown, sys.stdout)


def _wrap_note(line: str) -> str:
    """Wrap a line if it is a note."""
    return wrap(line, "    ") if line.lstrip().startswith("note: ") else line


def _check_directory_and_thread_variable() -> None:
    """Raise an error if the working directory or NUMBA_NUM_THREADS would make later imports fail."""
    try:
        os.getcwd()
    except OSError:
        raise InputError("the working directory no longer exists; change to another directory") from None
    threads = os.environ.get("NUMBA_NUM_THREADS", "").strip()
    if threads.lstrip("+-").isdecimal() and not float(threads) > 0:
        raise InputError(
            f"NUMBA_NUM_THREADS = {threads!r} is not a number of threads; set it to 1 or more, or unset it"
        )
