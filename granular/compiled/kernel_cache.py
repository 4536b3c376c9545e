"""Compiled kernels on disk: one file for each kernel, types of arguments, and processor.

Numba's own cache looks at the file of the function that is called alone, keeps an index that two
processes may write simultaneously, names its files by line numbers, and loads whatever it finds.
Here

- one digest of all kernels' sources stands for them all, since kernels call each other: editing one
  compiles all afresh, and nothing stale is ever run (see `granular.compiled.source_digest`);
- a file is loaded only if it is the user's own and whole (see `granular.shared.cache_files`), and what
  cannot be written is not kept: the worst that a cache can do to a run is to cost it time.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import pickle
import time
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import NullCache
from numba.core.serialize import dumps

from granular.compiled.cache_folder import digest_of_sources, kernel_cache_folder, write_cache_file
from granular.compiled.kernel_linking import rebuild_kernel
from granular.shared.cache_files import read_sealed_file
from granular.shared.file_locks import lock_file

ABANDONED = 86400.0
"""Age [s] from which a part of a file is nobody's any more."""


@functools.cache
def _delete_outdated_files(folder: Path) -> None:
    """Take out what former sources left, and parts of files that nobody will finish."""
    stamp = digest_of_sources()[:16]
    with contextlib.suppress(OSError):
        for path in folder.iterdir():
            stale = path.suffix == ".kernel" and not path.stem.endswith(stamp)
            part = path.suffix in (".part", ".lock") and path.stat().st_mtime < time.time() - ABANDONED
            if stale or part:
                path.unlink(missing_ok=True)


PATIENCE = 60.0
"""Time [s] for which a form is waited for that another process compiles."""
_LOOK = 0.02  # [s], from look to look whether it is there

_claims: dict[Path, contextlib.ExitStack] = {}
"""Locks of the forms that this process compiles."""


def _read_kernel_file_or_claim(path: Path, label: str) -> bytes | None:
    """Content of a form's file; None where this process is to compile it, and to write it."""
    latest = time.monotonic() + PATIENCE
    while (body := read_sealed_file(path, label)) is None and path not in _claims:
        claim = contextlib.ExitStack()
        try:
            claimed = claim.enter_context(lock_file(path.with_suffix(".lock"), wait=False))
        except OSError:  # nothing can be written here
            return None
        if claimed:
            _claims[path] = claim
        elif time.monotonic() > latest:
            return None
        else:
            time.sleep(_LOOK)
    if body is not None:
        _release_claim(path)
    return body


def _release_claim(path: Path) -> None:
    if path in _claims:
        _claims.pop(path).close()


class KernelCache(NullCache):
    """The compiled forms of one kernel, as Numba asks for them."""

    def __init__(self, function: Any, options: dict[str, Any]) -> None:
        self.name = f"{function.__module__}.{function.__qualname__}"
        self.options = repr(sorted(options.items()))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load the compiled form for these types of arguments."""
        target_context.refresh()
        entry = self._kernel_file_and_label(sig, target_context.codegen())
        body = None if entry is None else _read_kernel_file_or_claim(*entry)
        if body is None:
            return None
        try:
            types, payload = pickle.loads(body)
        except (ImportError, AttributeError):  # its modules were renamed while it was compiled
            return None
        return rebuild_kernel(target_context, payload) if types == sig else None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write the compiled form for these types of arguments to its file."""
        entry = self._kernel_file_and_label(sig, data.codegen)
        if entry is None:
            return
        # Dynamic globals are addresses in this process; in another they would point anywhere.
        if not data.library.has_dynamic_globals:
            _delete_outdated_files(entry[0].parent)
            write_cache_file(*entry, dumps((sig, data._reduce())))
        _release_claim(entry[0])

    def _kernel_file_and_label(self, sig: Any, codegen: Any) -> tuple[Path, str] | None:
        """File of a form, and all that it must have been made for."""
        folder = kernel_cache_folder()
        if folder is None:
            return None
        stamp = digest_of_sources()
        checked = numba.config.BOUNDSCHECK  # code with checks of indices is other code
        label = f"{self.name} {self.options} {sig} {codegen.magic_tuple()} {checked} {stamp}"
        key = hashlib.sha256(label.encode()).hexdigest()
        # 64 bits of each digest do: a clash is harmless, since the label in the file holds them in full.
        return folder / f"{self.name}-{key[:16]}-{stamp[:16]}.kernel", label


def cache_kernel(kernel: Any) -> None:
    """Keep the compiled forms of a kernel on disk."""
    kernel._cache = KernelCache(kernel.py_func, kernel.targetoptions)
