"""Folder where compiled kernels are kept, and the digest that stands for their sources."""

from __future__ import annotations

import functools
import hashlib
import shutil
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import llvmlite
import numba

from granular.compiled.source_digest import PACKAGE, digest_of_bytes, digest_of_syntax, read_compiled_sources
from granular.shared.cache_files import (
    read_sealed_file,
    toolkit_cache_folder,
    trusted_cache_folder,
    write_sealed_file,
)


@functools.cache
def kernel_cache_folder() -> Path | None:
    """Folder where kernels are kept: in ``NUMBA_CACHE_DIR``, or among the user's caches."""
    here = hashlib.sha256(f"{PACKAGE} {sys.implementation.cache_tag}".encode()).hexdigest()
    chosen = numba.config.CACHE_DIR
    home = Path(chosen) if chosen else toolkit_cache_folder()
    return trusted_cache_folder(home and home / f"kernels-{here[:16]}", "NUMBA_CACHE_DIR")


@functools.cache
def digest_of_sources() -> str:
    """Digest of all that the code of kernels depends on, but for arguments and processor."""
    files = read_compiled_sources()
    # Parsing takes a quarter of a second.
    syntax = read_or_compute("source", digest_of_bytes(files), lambda: digest_of_syntax(files))
    versions = f"{sys.version} {sys.flags.optimize} {numba.__version__} {llvmlite.__version__}"
    return hashlib.sha256(f"{versions} {syntax}".encode()).hexdigest()


def read_or_compute(name: str, label: str, compute: Callable[[], str]) -> str:
    """Text of a file in the folder that was made for a label, or as computed, and written there."""
    folder = kernel_cache_folder()
    sealed = None if folder is None else read_sealed_file(folder / name, label)
    if sealed is not None:
        return sealed.decode()
    result = compute()
    if folder is not None:
        write_cache_file(folder / name, label, result.encode())
    return result


def write_cache_file(path: Path, label: str, body: bytes) -> None:
    """Write a sealed file, or warn once that it cannot be written."""
    try:
        write_sealed_file(path, label, body)
    except OSError as error:
        _warn_once(f"{path.parent} cannot be written: {error.strerror}")


@functools.cache
def _warn_once(why: str) -> None:
    warnings.warn(f"compiled code is not kept: {why}; the next start compiles anew", stacklevel=3)


@functools.cache
def _numba_cache_folder() -> Path | None:
    """Folder for Numba's own cache, of these sources alone: Numba looks at one file of theirs."""
    folder = kernel_cache_folder()
    if folder is None:
        return None
    current = folder / f"njit-{digest_of_sources()[:16]}"
    for former in folder.glob("njit-*"):
        if former != current:
            shutil.rmtree(former, ignore_errors=True)
    return current


def cache_kernel_by_numba(kernel: Any) -> None:
    """Keep the compiled forms of an entry, which hold all kernels below it, by Numba's own cache."""
    folder, chosen = _numba_cache_folder(), numba.config.CACHE_DIR
    if folder is not None and "no_cpython_wrapper" not in kernel.targetoptions:
        numba.config.CACHE_DIR = str(folder)
        kernel.enable_caching()
        numba.config.CACHE_DIR = chosen
