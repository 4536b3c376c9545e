"""A user's class with static functions as a section of the scene."""

from __future__ import annotations

import collections
import dataclasses
import types as python_types
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numba

from granular.compiled.dispatch import OPTIONS
from granular.effects.own_definition import DEFINITIONS, Definition, functions_digest
from granular.schema.scales import Scales
from granular.schema.sections import Quantity, Section, Whole, unknown
from granular.shared.errors import InputError
from granular.shared.messages import quoted
from granular.shared.own_file import OwnFile, contents


class OwnSection(Section):
    """Base of what is made of a user's class.

    Attributes
    ----------
    definition : Definition
    written : type
        The class as it was written.
    origin : OwnFile or None
        The file that it came from, where the command line named one.
    made_by : function
        The decorator.
    """

    definition: ClassVar[Definition]
    written: ClassVar[type]
    origin: ClassVar[OwnFile | None] = None
    made_by: ClassVar[Callable[[type], Any]]

    @property
    def sources(self) -> tuple[str, ...]:
        """Digest of its functions, for the run's settings."""
        return (self.definition.digest,)

    def __reduce__(self) -> Any:
        """Any process can have it so: by the file's text, or by the class as it was written."""
        values = {one.name: getattr(self, one.name) for one in dataclasses.fields(self)}
        if self.origin is not None:
            return _of_file, (self.origin, self.definition.key, values)
        if self.__module__ != "__main__":
            return _of_module, (type(self), values)
        return _of_script, (type(self).made_by, self.written, values)


def mark_origin(file: OwnFile) -> dict[str, type[OwnSection]]:
    """The effects and wall laws that a file defines, by their names; they know the file then."""
    found = {}
    for one in list(contents(file).values()):
        own = isinstance(one, type) and issubclass(one, OwnSection)
        if own and one.__module__ == file.module:
            one.origin = file
            found[one.definition.key] = one
    return found


def _of_file(file: OwnFile, key: str, values: dict[str, Any]) -> Any:
    return mark_origin(file)[key](**values)


def _of_module(made: type, values: dict[str, Any]) -> Any:
    return made(**values)


def _of_script(made_by: Callable[[type], Any], written: type, values: dict[str, Any]) -> Any:
    return made_by(written)(**values)


def define(
    written: type, base: type[OwnSection], known: Sequence[str], needed: Sequence[str],
    what: str, /, **more: Any,
) -> Any:  # fmt: skip
    """A subclass of ``base`` with the class's parameters, and its functions as ``definition``.

    Parameters
    ----------
    written : type
        As the user wrote it.
    base : type
    known, needed : sequence of str
        Names of the functions that there may be, and must be.
    what : str
        In messages: ``"effect"``.
    **more
        Further attributes of the made class.

    Raises
    ------
    InputError
        If the class is no such.
    """
    key = name_of(written)
    content = {
        name: value
        for name, value in vars(written).items()
        if name not in ("__dict__", "__weakref__")
    }
    functions = functions_in(content)
    for name in functions:
        if name not in known:
            raise InputError(f"{what} {key!r}: {unknown(name, tuple(known), 'function')}")
    for name in needed:
        if name not in functions:
            raise InputError(f"{what} {key!r} has no {name!r}; give it, as a static method")
    for name, value in content.items():
        taken = hasattr(base, name) and name not in more
        if not name.startswith("_") and name not in functions and taken:
            raise InputError(f"{what} {key!r}: {quoted(name)} has a meaning of its own; rename it")
        if isinstance(value, python_types.FunctionType):
            raise InputError(f"{what} {key!r}: {name!r} must be static; write @staticmethod above")
    fields = [name for name in content.get("__annotations__", {}) if name not in functions]
    definition = Definition(
        key,
        f"{key}_{functions_digest(functions, fields)}",
        collections.namedtuple("Parameters", fields),
        functions,
        {name: _kernel(function) for name, function in functions.items()},
    )
    DEFINITIONS[definition.digest] = definition
    for name in functions:
        del content[name]
    made = type(
        written.__name__, (base,), content | {"definition": definition, "written": written} | more
    )
    for field in dataclasses.fields(made):
        if not isinstance(field.metadata.get("kind"), Quantity | Whole):
            raise InputError(f"{what} {key!r}: {field.name} must be a number; give quantity(unit)")
    return made


def name_of(written: type) -> str:
    """What scenes call a class: ``LeafSpring`` is ``leaf_spring``."""
    words = "".join(f"_{one.lower()}" if one.isupper() else one for one in written.__name__)
    return words.lstrip("_")


def functions_in(content: dict[str, Any]) -> dict[str, Callable[..., Any]]:
    """The static methods of a class by their names."""
    return {
        name: value.__func__ for name, value in content.items() if isinstance(value, staticmethod)
    }


def natural_values(section: Section, definition: Definition, scales: Scales) -> Any:
    """The parameters of a section in natural units."""
    values = []
    for field in dataclasses.fields(section):
        kind = field.metadata["kind"]
        unit = kind.unit if isinstance(kind, Quantity) else "1"
        values.append(float(getattr(section, field.name)) / scales.unit(unit))
    return definition.parameters(*values)


def _kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    return numba.njit(**OPTIONS)(function)
