"""Show default and limits of each key of a scene's sections in the reference.

The docstrings of sections explain the meaning and unit of a key; the declarations next to them contain
default and limits. This extension of griffe appends default and limits to the docstrings, using the source
text only.
"""

from __future__ import annotations

import ast
import re
from typing import Any

import griffe

KINDS = ("quantity", "quantity_list_field", "integer_field", "choice_field", "text_field", "flag_field")
LIMITS = {"above": "above", "least": "at least", "below": "below", "most": "at most"}
HEADER = re.compile(r"^(?P<names>\w+(?:, \w+)*) : ")


class SectionKeys(griffe.Extension):
    """Extend the docstrings of all classes derived from `granular.schema.sections.Section`."""

    def on_class(self, *, cls: griffe.Class, **_: Any) -> None:
        if cls.docstring is None:
            return
        words = {
            name: limits_in_words(str(member.value))
            for name, member in cls.members.items()
            if member.is_attribute and member.value is not None
        }
        cls.docstring.value = with_limits(cls.docstring.value, words)


class DefaultValues(griffe.Extension):
    """Show the value of a default that is given by the name of a constant."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        show_defaults(pkg)


def show_defaults(place: griffe.Module | griffe.Class) -> None:
    """Replace defaults of all functions in a module or class, recursively."""
    for member in place.members.values():
        if isinstance(member, (griffe.Module, griffe.Class)):
            show_defaults(member)
        elif isinstance(member, griffe.Function):
            for parameter in member.parameters:
                value = constant(str(parameter.default), member.module)
                if is_plain(value):
                    parameter.default = value


def constant(name: str, module: griffe.Module) -> str:
    """The source text of a constant of a module, including imported ones; empty for other names."""
    known = module.members.get(name)
    try:
        found = known.final_target if isinstance(known, griffe.Alias) else known
    except griffe.GriffeError:
        return ""
    return str(found.value) if isinstance(found, griffe.Attribute) else ""


def is_plain(source: str) -> bool:
    """Whether a source text is a number or string, or a few of them."""
    try:
        ast.literal_eval(source)
    except (SyntaxError, ValueError):
        return False
    return True


def limits_in_words(declaration: str) -> str:
    """Default and limits of a key, from the call that declares it; empty for other values."""
    try:
        call = ast.parse(declaration, mode="eval").body
    except SyntaxError:
        return ""
    if not isinstance(call, ast.Call) or getattr(call.func, "id", "") not in KINDS:
        return ""
    given = {one.arg: written(one.value) for one in call.keywords}
    said = [f"{word} {given[key]}" for key, word in LIMITS.items() if key in given]
    if "default" not in given:
        said.append("must be given")
    elif given["default"] == "None":
        said.append("optional")
    else:
        said.append(f"default {given['default']}")
    return f"*({', '.join(said)})*"


def written(value: ast.expr) -> str:
    """A value in its usual notation: 0 for 0.0."""
    if isinstance(value, ast.Constant) and isinstance(value.value, float):
        return f"{value.value:g}"
    return ast.unparse(value).replace(" ** ", "^").replace("math.pi", "pi")


def join_words(found: list[str]) -> str:
    """The text for keys that share a description, without repetition."""
    return found[0] if len(set(found)) == 1 else " ".join(filter(None, found))


def with_limits(docstring: str, words: dict[str, str]) -> str:
    """The docstring with default and limits after the description of each attribute."""
    lines: list[str] = []
    pending = ""
    for line in [*docstring.splitlines(), ""]:
        header = HEADER.match(line)
        if pending and (header or not line.strip()):
            lines.append(f"    {pending}")
            pending = ""
        if header:
            pending = join_words([words.get(name, "") for name in header["names"].split(", ")])
        lines.append(line)
    return "\n".join(lines).rstrip()
