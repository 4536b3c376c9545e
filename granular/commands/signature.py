"""Derive the options of a command from the signature of its function.

    def run(
        scene: SceneName,  # an argument of the command, since it is positional in Python
        *,
        t_end: Annotated[Seconds | None, Option("stop at this time, such as 0.5 or '500 ms'", "T")] = None,
        resume: Annotated[bool, Option("continue the run in DIR")] = False,
        output: OutputOptions,  # a dataclass: a group of options
    ) -> None:
        \"\"\"Run a scene.\"\"\"

``t_end`` is ``--t-end T``, read as a time in SI. A tuple is an option that may be given several times, a
`Literal` is a choice, and a `Registry` allows one of its names. Parameters without a default are required.
Annotations are evaluated, so their names are imported at run time.
"""

from __future__ import annotations

import argparse
import dataclasses
import inspect
from collections.abc import Callable, Iterator
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

from granular.shared.errors import GranularError
from granular.shared.registry import Registry

_NONE = type(None)


class Option(NamedTuple):
    """Help text of an option or argument, and its names if they differ from the parameter's name."""

    help: str
    metavar: str | None = None
    short: str | None = None
    name: str | None = None
    nargs: str | None = None


class OptionReader(NamedTuple):
    """Function that converts an option's string to a value, and may raise an `InputError`."""

    read: Callable[[str], Any]


def make_quantity_reader(unit: str) -> OptionReader:
    """Make a reader of quantities, such as '500 ms', in SI."""

    def read(text: str) -> float:
        from granular.schema.units import si_value

        return si_value(text, unit)

    return OptionReader(read)


Seconds = Annotated[float, make_quantity_reader("s")]
Hertz = Annotated[float, make_quantity_reader("Hz")]
Metres = Annotated[float, make_quantity_reader("m")]
Kilograms = Annotated[float, make_quantity_reader("kg")]
Fraction = Annotated[float, make_quantity_reader("1")]


class _OptionField(NamedTuple):
    name: str
    hint: Any
    default: Any
    is_option: bool


def add_options(parser: argparse._ActionsContainer, carry_out: Callable[..., None]) -> None:
    """Add the options of a function to a parser."""
    for field in _option_fields_of_function(carry_out):
        if dataclasses.is_dataclass(field.hint):
            add_option_group(parser, field.hint)
        else:
            _add_option(parser, field)


def add_option_group(parser: argparse._ActionsContainer, group: Any) -> None:
    """Add the options of a group (a dataclass) to a parser, under the title of the group if it has one."""
    title = getattr(group, "title", None)
    target = parser if title is None else parser.add_argument_group(title)
    for member in _option_fields_of_group(group):
        _add_option(target, member)


def collect_arguments_from_options(
    carry_out: Callable[..., None], options: argparse.Namespace
) -> dict[str, Any]:
    """Collect the arguments of a function from the parsed options."""
    arguments: dict[str, Any] = {}
    for field in _option_fields_of_function(carry_out):
        if dataclasses.is_dataclass(field.hint):
            values = {
                member.name: _value_of_field_from_options(member, options)
                for member in _option_fields_of_group(field.hint)
            }
            arguments[field.name] = field.hint(**values)  # type: ignore[operator]  # a class
        else:
            arguments[field.name] = _value_of_field_from_options(field, options)
    return arguments


def _option_fields_of_function(carry_out: Callable[..., None]) -> list[_OptionField]:
    hints = get_type_hints(carry_out, include_extras=True)
    return [
        _OptionField(name, hints[name], given.default, given.kind is given.KEYWORD_ONLY)
        for name, given in inspect.signature(carry_out).parameters.items()
    ]


def _option_fields_of_group(group: Any) -> list[_OptionField]:
    hints = get_type_hints(group, include_extras=True)
    missing, empty = dataclasses.MISSING, inspect.Parameter.empty
    return [
        _OptionField(
            field.name, hints[field.name], empty if field.default is missing else field.default, True
        )
        for field in dataclasses.fields(group)
    ]


def _value_of_field_from_options(field: _OptionField, options: argparse.Namespace) -> Any:
    value = getattr(options, field.name)
    return tuple(value) if isinstance(value, list) else field.default if value is None else value


def _types_and_metadata_of_annotation(hint: Any) -> Iterator[Any]:
    """Yield the types in an annotation, and its metadata from the outermost to the innermost."""
    if get_origin(hint) is Annotated:
        inner, *notes = get_args(hint)
        yield from reversed(notes)  # the outermost first
        yield from _types_and_metadata_of_annotation(inner)
    elif get_args(hint) and get_origin(hint) is not Literal:
        for part in get_args(hint):
            yield from _types_and_metadata_of_annotation(part)
    else:
        yield hint


def _add_option(parser: argparse._ActionsContainer, field: _OptionField) -> None:
    parts = list(_types_and_metadata_of_annotation(field.hint))
    option = next(part for part in parts if isinstance(part, Option))
    names = [field.name]
    if field.is_option:
        long = option.name or f"--{field.name.replace('_', '-')}"
        names = [long] if option.short is None else [option.short, long]
    parser.add_argument(*names, **_argparse_settings(field, option, parts))


def _argparse_settings(field: _OptionField, option: Option, parts: list[Any]) -> dict[str, Any]:
    """Make the settings of argparse for an option or an argument."""
    settings: dict[str, Any] = {"help": option.help}
    required = field.default is inspect.Parameter.empty
    if field.is_option:
        settings |= {"dest": field.name, "required": required}
    if not required:
        settings["default"] = field.default
    if bool in parts:
        return settings | {"action": argparse.BooleanOptionalAction if _NONE in parts else "store_true"}
    if option.metavar is not None:
        settings["metavar"] = option.metavar
    choices = [part for part in parts if get_origin(part) is Literal]
    if choices:
        settings["choices"] = get_args(choices[0])
    readers = [part.read for part in parts if isinstance(part, OptionReader)]
    for registry in (part for part in parts if isinstance(part, Registry)):
        settings["choices"] = tuple(registry)
        readers = [registry.require]
    if readers:
        settings["type"] = _reader_with_argparse_errors(readers[0])
    elif number := next((kind for kind in (int, float) if kind in parts), None):
        settings["type"] = number
    if option.nargs is not None:
        settings["nargs"] = option.nargs
    elif Ellipsis in parts and field.is_option:
        settings |= {"action": "append", "default": None}
    elif Ellipsis in parts:
        settings["nargs"] = "+" if required else "*"
    return settings


def _reader_with_argparse_errors(read: Callable[[str], Any]) -> Callable[[str], Any]:
    """Convert errors of a reader to errors of argparse, which name the option."""

    def type_of_option(text: str) -> Any:
        try:
            return read(text)
        except GranularError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return type_of_option
