"""Digest of functions and of everything that they use, which changes with code and values.

The digest includes a function's code, defaults and closure, and the variables of its file that it uses:
numbers, complete tables, and recursively functions, classes and modules. For a module that is imported during
a call, the digest includes the content of its file. Objects of the standard library, of installed packages
and of this toolkit enter only by name. Keys of results that are stored for long should therefore also include
versions.
"""

from __future__ import annotations

import dis
import hashlib
import importlib.util
import sys
import sysconfig
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

DIGITS = 24
"""Number of hexadecimal digits; 96 bits avoid accidental collisions among a billion functions."""

TOOLKIT = frozenset({"granular", "reduced_models", "validation"})

_PLAIN = frozenset({type(None), bool, int, float, complex, str, bytes, type(...)})
"""Types whose `repr` contains the complete value."""

_LIBRARY_FOLDERS = tuple(
    Path(path) for path in {sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")}
)

Content = tuple[str, Iterable[Any]]
"""Description of an object, and the objects of which it consists."""


def functions_digest(functions: Mapping[str, Callable[..., Any]], parameters: Sequence[str] = ()) -> str:
    """Compute one digest of named functions, of everything that they use, and of parameter names."""
    homes = {_top_package(function.__module__) for function in functions.values()}
    walk = _DigestWalk(homes - TOOLKIT - sys.stdlib_module_names)
    digest = hashlib.sha256(repr(list(parameters)).encode())
    for name in sorted(functions):
        digest.update(f"\0{name}\0".encode() + walk.digest_of_root_function(functions[name]))
    return digest.hexdigest()[:DIGITS]


class _DigestWalk:
    """Traversal of a function and the objects that it uses, each of which is digested once."""

    def __init__(self, followed_packages: set[str]) -> None:
        self._followed_packages = followed_packages
        self._seen: dict[int, tuple[object, bytes]] = {}

    def digest_of_root_function(self, function: Callable[..., Any]) -> bytes:
        """Digest a function by its code, even if it is a function of a library."""
        plain = getattr(function, "py_func", function)
        content = (
            _digest_content_of_function(plain) if isinstance(plain, FunctionType) else self._content(plain)
        )
        return self._digest_of_content(content)

    def _digest(self, value: object) -> bytes:
        if id(value) in self._seen:
            return self._seen[id(value)][1]
        # The object itself is kept, so that its id is not reused.
        self._seen[id(value)] = value, b"within itself"
        result = self._digest_of_content(self._content(value))
        self._seen[id(value)] = value, result
        return result

    def _digest_of_content(self, content: Content) -> bytes:
        words, parts = content
        digest = hashlib.sha256(words.encode("utf-8", "backslashreplace"))
        for part in parts:
            digest.update(self._digest(part))
        return digest.digest()

    def _content(self, value: Any) -> Content:
        kind = type(value)
        name = f"{kind.__module__}.{kind.__qualname__} "
        if kind in _PLAIN:
            return repr(value), ()
        if isinstance(value, ModuleType):
            entries = sorted(vars(value).items()) if self._is_user_module(value.__name__) else []
            return f"module {value.__name__}", _without_dunders(entries)
        if isinstance(value, CodeType):
            return _code_as_text(value), value.co_consts
        if isinstance(value, FunctionType) and self._is_user_module(value.__module__):
            return _digest_content_of_function(value)
        if isinstance(value, type) and self._is_user_module(value.__module__):
            members = ((key, held) for key, held in vars(value).items() if key != "__annotations__")
            return f"class {value.__qualname__}", (value.__bases__, *_without_dunders(members))
        if hasattr(value, "py_func"):  # compiled by Numba
            return f"{name} {getattr(value, 'targetoptions', None)}", (value.py_func,)
        if hasattr(value, "__wrapped__"):  # static, or with a cache
            return name, (value.__wrapped__,)
        if hasattr(value, "__qualname__"):
            owner = getattr(value, "__self__", None)
            return f"{getattr(value, '__module__', None)}.{value.__qualname__}", (owner,)
        return self._content_of_instance(value, name)

    def _content_of_instance(self, value: Any, name: str) -> Content:
        if isinstance(value, np.ndarray) and not value.dtype.hasobject:
            numbers = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
            return f"{name} {value.dtype.descr} {value.shape} {numbers}", ()
        if isinstance(value, set | frozenset):  # the order differs between processes
            return name, sorted(map(self._digest, value))
        if isinstance(value, property):
            return name, (value.fget, value.fset, value.fdel)
        if type(value) in (tuple, list):
            return f"{name} {len(value)}", value
        if type(value) is dict:
            return f"{name} {len(value)}", (part for item in value.items() for part in item)
        try:
            made = value.__reduce_ex__(4)  # as for a copy
        except Exception:  # for example a file or a lock: only its type counts
            return name, ()
        if isinstance(made, str):
            return f"{name} {made}", ()
        return name, [list(part) if isinstance(part, Iterator) else part for part in made]

    def _is_user_module(self, module: str | None) -> bool:
        """Return True if a module belongs neither to the toolkit nor to a library, so that it is digested."""
        top = _top_package(module)
        if top in self._followed_packages:
            return True
        if top in TOOLKIT or top in sys.stdlib_module_names:
            return False
        file = getattr(sys.modules.get(top), "__file__", None)
        return file is None or not _is_of_library(Path(file))


def _is_of_library(file: Path) -> bool:
    return any(file.is_relative_to(folder) for folder in _LIBRARY_FOLDERS)


def _top_package(module: str | None) -> str:
    return (module or "").partition(".")[0]


def _without_dunders(items: Iterable[tuple[str, Any]]) -> Iterator[Any]:
    """Yield names and values; names such as ``__doc__``, which hold no function, are omitted."""
    for name, value in items:
        if isinstance(value, FunctionType) or not (name.startswith("__") and name.endswith("__")):
            yield name
            yield value


def _code_as_text(code: CodeType) -> str:
    names = code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
    counts = code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags
    return repr((names, counts, code.co_code, code.co_exceptiontable))


def _digest_content_of_function(function: FunctionType) -> Content:
    names, imported = set[str](), set[str]()
    for code in _iterate_nested_code(function.__code__):
        names.update(code.co_names)
        imported.update(step.argval for step in dis.get_instructions(code) if step.opname == "IMPORT_NAME")
    known = function.__globals__
    used = {name: known[name] for name in sorted(names) if name in known}
    modules = {name: _module_file(name) for name in sorted(imported)}
    cells = [_closure_cell_content(cell) for cell in function.__closure__ or ()]
    return "function", (
        function.__code__,
        function.__defaults__,
        function.__kwdefaults__,
        cells,
        used,
        modules,
        vars(function),
    )


def _iterate_nested_code(code: CodeType) -> Iterator[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _iterate_nested_code(constant)


def _module_file(name: str) -> bytes | None:
    """Read the file of a module that a function imports when called; return None for a library."""
    try:
        origin = getattr(importlib.util.find_spec(name), "origin", None)
    except (ImportError, ValueError):
        return None
    file = Path(origin or "")
    return file.read_bytes() if file.suffix == ".py" and not _is_of_library(file) else None


def _closure_cell_content(cell: Any) -> Any:
    try:
        return cell.cell_contents
    except ValueError:  # not set yet
        return None
