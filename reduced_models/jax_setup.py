"""JAX as this package needs it: double precision, and compiled code kept on disk.

Import ``jax`` from here, so that the settings stand before the first array is made, and compile by `jit`.
"""

from __future__ import annotations

import contextlib
import functools
import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from granular.shared.cache_files import toolkit_cache_folder, trusted_cache_folder
from granular.shared.errors import InputError
from granular.shared.message_text import quote, sanitize
from granular.shared.stop_signals import defer_stop_signals

with defer_stop_signals():  # broken off, the import of JAX's C++ ended in a segmentation fault
    import diffrax  # noqa: F401
    import jax

_VARIABLE = "JAX_COMPILATION_CACHE_DIR"


def _cache_folder() -> Path | None:
    """Folder where compiled code is kept; see `granular.shared.cache_files.trusted_cache_folder`."""
    chosen = os.environ.get(_VARIABLE)
    home = toolkit_cache_folder()
    return trusted_cache_folder(Path(chosen) if chosen else home and home / "jax", _VARIABLE)


def _check_platform(chosen: str) -> None:
    """Refuse a device that JAX is set to take and does not find, before anything is computed."""
    try:
        with jax_call():
            jax.devices()
    except (RuntimeError, AssertionError) as error:  # the latter where its plug-in is missing
        why = f", {error}" if str(error) else ""
        raise InputError(
            f"JAX_PLATFORMS = {quote(chosen)}, which JAX cannot use here{sanitize(why)}; unset it, "
            "or set it to cpu"
        ) from None


P = ParamSpec("P")
T = TypeVar("T")

_within = threading.local()
_users: set[int] = set()
"""Process that has called JAX, and by a fork of it this one."""


@contextlib.contextmanager
def jax_call() -> Iterator[None]:
    """Defer stops while JAX works, and refuse to call it in a fork of a process that has called it.

    Broken off while it traces or compiles, JAX shows a hundred lines, or its C++ ends the process; a fork
    has none of its threads, and would wait for them for ever.
    """
    if getattr(_within, "call", False):
        yield
        return
    _users.add(os.getpid())
    if len(_users) > 1:
        raise InputError(
            f"process {os.getpid()} was forked from one that has called JAX, in which JAX hangs; start "
            "processes with multiprocessing.get_context('spawn')"
        )
    _within.call = True
    try:
        with defer_stop_signals():
            yield
    finally:
        _within.call = False


def jit(function: Callable[P, T]) -> Callable[P, T]:
    """Compile a function by JAX, to be called by `jax_call`."""
    compiled = jax.jit(function)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        with jax_call():
            result: T = compiled(*args, **kwargs)
            return result

    return call


_set: Any = jax.config.update
_set("jax_enable_x64", True)
_folder = _cache_folder()
_set("jax_compilation_cache_dir", None if _folder is None else str(_folder))
_set("jax_persistent_cache_min_compile_time_secs", 0.0)
_set("jax_persistent_cache_min_entry_size_bytes", -1)

if "JAX_PLATFORMS" in os.environ:
    _check_platform(os.environ["JAX_PLATFORMS"])

__all__ = ["jax", "jax_call", "jit"]
