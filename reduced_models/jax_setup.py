"""Settings of JAX: double precision, and compiled programs that are stored on disk.

Import ``jax`` from this module, so that the settings are made before the first array. `Compiled` wraps a
function that JAX compiles.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import pickle
import threading
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar

import numpy as np

from granular.shared.errors import InputError, quote, sanitize
from granular.shared.files import (
    read_sealed_file,
    toolkit_cache_folder,
    trusted_cache_folder,
    write_sealed_file,
)
from granular.shared.stop_signals import defer_stop_signals

with defer_stop_signals():  # an interrupted import of JAX's C++ ended in a segmentation fault
    import diffrax  # noqa: F401
    import jax
    from jax.experimental.compilation_cache.compilation_cache import reset_cache
    from jax.experimental.serialize_executable import deserialize_and_load, serialize

_VARIABLE = "JAX_COMPILATION_CACHE_DIR"


def _cache_folder() -> Path | None:
    """Return the folder for compiled programs; see `granular.shared.files.trusted_cache_folder`."""
    chosen = os.environ.get(_VARIABLE)
    home = toolkit_cache_folder()
    return trusted_cache_folder(Path(chosen) if chosen else home and home / "jax", _VARIABLE)


def _check_platform(chosen: str) -> None:
    """Raise an error, before anything is computed, if JAX cannot use the chosen device."""
    try:
        with guard_jax_call():
            jax.devices()
    except (RuntimeError, AssertionError) as error:  # the latter if the plug-in is missing
        why = f", {error}" if str(error) else ""
        raise InputError(
            f"JAX_PLATFORMS = {quote(chosen)}, which JAX cannot use here{sanitize(why)}; unset it, "
            "or set it to cpu"
        ) from None


P = ParamSpec("P")
T = TypeVar("T")

_within = threading.local()
_users: set[int] = set()
"""Identifiers of the processes that have called JAX: the present process and, if it was forked, its
parent."""


@contextlib.contextmanager
def guard_jax_call() -> Iterator[None]:
    """Defer stop signals while JAX works; raise an error in a fork of a process that has called JAX.

    If JAX is interrupted while it traces or compiles, it prints a hundred lines, or its C++ code ends the
    process. A forked process lacks the threads of JAX and would wait for them forever.
    """
    if getattr(_within, "call", False):
        yield
        return
    _users.add(os.getpid())
    if len(_users) > 1:
        raise InputError(
            f"process {os.getpid()} was forked from a process that has called JAX, and JAX would "
            "hang in it; start processes with multiprocessing.get_context('spawn')"
        )
    _within.call = True
    try:
        with defer_stop_signals():
            yield
    finally:
        _within.call = False


class Compiled(Generic[P, T]):
    """A function that JAX compiles for each type of its arguments; stored on disk if ``form`` is given."""

    def __init__(self, function: Callable[P, T], form: object = None) -> None:
        functools.update_wrapper(self, function)
        self._compiled, self._form = jax.jit(function), form
        self._label = f"{function.__module__}.{function.__qualname__} {form!r}"
        self._programs: dict[Any, Callable[P, T]] = {}

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> T:
        """Call the compiled program for arguments of these types."""
        with guard_jax_call():
            leaves, tree = jax.tree.flatten((args, kwargs))
            if self._form is None or any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
                result: T = self._compiled(*args, **kwargs)
                return result
            types = _argument_types(leaves, tree)
            if types not in self._programs:
                label = _program_file_label(f"{self._label} {types}")
                self._programs[types] = _load_or_compile(label, self._compiled, args, kwargs)
            return self._programs[types](*args, **kwargs)

    def compile_ahead(self, *args: P.args, **kwargs: P.kwargs) -> None:
        """Compile the program for arguments of these types and store it, unless it is already stored."""
        with guard_jax_call():
            types = _argument_types(*jax.tree.flatten((args, kwargs)))
            label = _program_file_label(f"{self._label} {types}")
            if label is not None and not _program_path(label).exists():
                self._programs[types] = _load_or_compile(label, self._compiled, args, kwargs)


def _argument_types(leaves: Sequence[Any], tree: Any) -> tuple[Any, ...]:
    return tree, *((np.shape(leaf), getattr(leaf, "dtype", type(leaf))) for leaf in leaves)


def _program_file_label(label: str) -> str | None:
    """Return a label of all that a program depends on, for its file; None if programs are not stored."""
    processor = _processor_description()
    if _folder is None or processor is None or jax.default_backend() != "cpu":
        return None
    return label + processor + _digest_of_dependencies()


def _program_path(label: str) -> Path:
    assert _folder is not None
    return _folder / f"{hashlib.sha256(label.encode()).hexdigest()}.program"


def _load_or_compile(label: str | None, compiled: Any, args: Any, kwargs: Any) -> Any:
    """Read the program for arguments of these types from its file, or compile it and write the file."""
    # JAX's own cache finds compiled code only after tracing, which takes longer than to load it.
    if label is None:
        return compiled
    path = _program_path(label)
    body = read_sealed_file(path, label)
    if body is not None:
        return deserialize_and_load(*pickle.loads(body))
    lowered = compiled.lower(*args, **kwargs)
    with _without_jax_cache():
        result = lowered.compile()
    # A stored program that calls a library, such as LAPACK, crashes unless tracing has registered the call.
    if "custom_call" not in lowered.as_text():
        with contextlib.suppress(OSError):  # a full disk costs time only
            write_sealed_file(path, label, pickle.dumps(serialize(result)))
    return result


@contextlib.contextmanager
def _without_jax_cache() -> Iterator[None]:
    """Switch off JAX's cache: a program read from this cache lacks functions if it is stored again."""
    try:
        _set("jax_enable_compilation_cache", False)
        reset_cache()  # otherwise the first setting would persist
        yield
    finally:
        _set("jax_enable_compilation_cache", True)
        reset_cache()


@functools.cache
def _processor_description() -> str | None:
    """Return name and features of the processor, or None if ``llvmlite``, which reports them, is missing."""
    try:
        from llvmlite.binding import get_host_cpu_features, get_host_cpu_name
    except ImportError:
        return None
    return f"{get_host_cpu_name()} {get_host_cpu_features().flatten()}"


@functools.cache
def _digest_of_dependencies() -> str:
    """Return a digest of all that a program depends on except ``form``: sources, versions, settings."""
    digest = hashlib.sha256()
    versions = [version(name) for name in ("jax", "jaxlib", "diffrax", "equinox", "sympy")]
    digest.update(f"{versions} {os.environ.get('XLA_FLAGS')} {jax.config.values}".encode())
    package = Path(__file__).parent
    for folder in (package, package.parent / "granular" / "formulas"):
        for path in sorted(folder.rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


_set: Any = jax.config.update
_set("jax_enable_x64", True)
_folder = _cache_folder()
_set("jax_compilation_cache_dir", None if _folder is None else str(_folder))
_set("jax_persistent_cache_min_compile_time_secs", 0.0)
_set("jax_persistent_cache_min_entry_size_bytes", -1)

if "JAX_PLATFORMS" in os.environ:
    _check_platform(os.environ["JAX_PLATFORMS"])

__all__ = ["Compiled", "guard_jax_call", "jax"]
