"""Registries of extensible parts (effects, laws, methods, ...) by name.

Each kind of part has a `Registry` with built-in parts, custom parts and parts from installed packages. A
built-in part may be given as "module:attribute". It is then imported on use, and omitted if the module is
missing. Installed packages add parts by entry points in the group of the kind. A part that cannot be loaded
is reported with package and version, and does not affect the others.
"""

from __future__ import annotations

import functools
import importlib.metadata
import importlib.util
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import EntryPoint
from typing import Any, TypeVar

from granular.shared.errors import InputError, missing_package_error, one_line, quote, unknown_word_message

Named = TypeVar("Named")


class Registry(Mapping[str, Named]):
    """Parts of one kind by name; a printed registry shows a line with a description of each part."""

    def __init__(
        self,
        kind: str,  # noun for messages
        group: str,  # group of entry points of installed packages
        built_in: Mapping[str, Named | str],  # objects, or "module:attribute"
        accepts: Callable[[str, Any], bool],  # returns True for a valid name and object of a package
        wanted: str,  # description of an accepted object
        describe: Callable[[Named], str] = str,
        from_files: bool = False,  # True if files of --import can also add parts
    ) -> None:
        self.kind, self.group = kind, group
        self._built_in, self._own = dict(built_in), dict[str, Named]()
        self._accepts, self._wanted, self._describe = accepts, wanted, describe
        self._from_files = from_files

    @property
    def built_in(self) -> tuple[str, ...]:
        """Names of the toolkit's built-in parts whose modules are installed."""
        return tuple(name for name, thing in self._built_in.items() if _is_importable(thing))

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*self.built_in, *self._own, *_installed_entry_points(self.group))))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __contains__(self, name: Any) -> bool:
        if not isinstance(name, str):
            return False
        here = name in self._built_in and _is_importable(self._built_in[name])
        return here or name in self._own or name in _installed_entry_points(self.group)

    def __getitem__(self, name: str) -> Named:
        if name not in self:
            raise KeyError(name)
        thing = self._own.get(name, self._built_in.get(name))
        if isinstance(thing, str):
            return self._load_built_in(EntryPoint(name, thing, self.group))
        return self._load_installed(_installed_entry_points(self.group)[name]) if thing is None else thing

    def __repr__(self) -> str:
        width = max(map(len, self), default=0)
        return "\n".join(f"{name:{width}}  {words}" for name, words in self.descriptions().items())

    def find(self, name: str) -> Named:
        """Return the part with this name; for an unknown name, raise InputError with the valid names."""
        return self[self.require(name)]

    def require(self, name: str) -> str:
        """Return the name if it exists, without loading the part; else raise InputError as `find` does."""
        if name not in self:
            files = "by --import FILE, or " if self._from_files else ""
            raise InputError(
                f"{unknown_word_message(name, tuple(self), self.kind)}; a custom {self.kind} can be added "
                f"{files}by an installed package with an entry point in the group {self.group!r}"
            )
        return name

    def register(self, name: str, thing: Named) -> None:
        """Add a custom part until the process ends; a custom part of the same name is replaced."""
        if name in self._built_in:
            raise InputError(f"{self.kind} {quote(name)} is built in; give your {self.kind} another name")
        self._own[name] = thing

    def load(self) -> tuple[dict[str, Named], dict[str, InputError]]:
        """Load all parts; return the parts by name, and the errors of parts that cannot be loaded."""
        working, errors = dict[str, Named](), dict[str, InputError]()
        for name in self:
            try:
                working[name] = self[name]
            except InputError as error:
                errors[name] = error
        return working, errors

    def usable_parts(self) -> dict[str, Named]:
        """Return all parts that can be loaded, by name; warn about each part that cannot be loaded."""
        working, errors = self.load()
        for error in errors.values():
            warnings.warn(f"{error}; it is not used", stacklevel=2)
        return working

    def registered(self, name: str) -> Named | None:
        """Return the built-in or custom part with this name, or None; installed packages are not searched."""
        return self[name] if name in self._own or name in self.built_in else None

    def descriptions(self) -> dict[str, str]:
        """Return a line of description for each part by name; warn of packages that use a built-in name."""
        for name in self._built_in.keys() & _installed_entry_points(self.group).keys():
            package = _package_name_and_version(_installed_entry_points(self.group)[name])
            who = f"{self.kind} {quote(name)}{package}"
            warnings.warn(f"{who} is not used, because a built-in {self.kind} has this name", stacklevel=2)
        working, errors = self.load()
        described = {name: self._describe(thing) for name, thing in working.items()}
        return {name: described.get(name, str(errors.get(name))) for name in self}

    def origin(self, name: str) -> str:
        """Describe a part by its kind and name, and by the installed package that provides it, if any."""
        point = (
            None if name in self._built_in or name in self._own else _installed_entry_points(self.group)[name]
        )
        return f"{self.kind} {quote(name)}{'' if point is None else _package_name_and_version(point)}"

    def _load_built_in(self, point: EntryPoint) -> Named:
        try:
            return point.load()
        except ModuleNotFoundError as error:
            raise missing_package_error(error) or InputError(
                f"{self.kind} {quote(point.name)} needs {error.name}, which is missing; "
                "install the whole toolkit"
            ) from error

    def _load_installed(self, point: EntryPoint) -> Named:
        who = self.origin(point.name)
        try:
            thing = point.load()
        except (Exception, SystemExit) as error:  # a script without a main guard exits
            words = one_line(f"{type(error).__name__}: {error}")
            raise InputError(
                f"{who} cannot be loaded: {words}; correct {quote(point.value)}, or uninstall the package"
            ) from error
        try:
            is_accepted = self._accepts(point.name, thing) and isinstance(self._describe(thing), str)
        except Exception:
            is_accepted = False
        if not is_accepted:
            raise InputError(f"{who} is not {self._wanted}; correct {quote(point.value)}")
        return thing


def _package_name_and_version(point: EntryPoint) -> str:
    """Return name and version of the package of an entry point."""
    return "" if point.dist is None else f" of {point.dist.name} {point.dist.version}"


def _is_importable(thing: object) -> bool:
    """Return False if a part is given as "module:attribute" and that module is missing."""
    try:
        return not isinstance(thing, str) or importlib.util.find_spec(thing.partition(":")[0]) is not None
    except ModuleNotFoundError:
        return False


def _installed_entry_points(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group by name, from the packages on the present import path."""
    return _entry_points_in_folders(tuple(sys.path), group)


@functools.cache
def _entry_points_in_folders(folders: tuple[str, ...], group: str) -> dict[str, EntryPoint]:
    points = dict[str, EntryPoint]()
    for point in _all_entry_points(folders).select(group=group):
        points.setdefault(point.name, point)  # the package that comes first on the path
    return points


@functools.cache
def _all_entry_points(_: tuple[str, ...]) -> Any:
    return importlib.metadata.entry_points()
