"""Digests, folders and timers for the cache of compiled kernels, and a check of Numba's internals.

The functions here compute the digest of the kernels' sources without comments and docstrings, find the folder
of compiled kernels, which also holds Numba's cache, and measure compile times. With an untested version of
Numba they check whether its internals are compatible.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import llvmlite
import numba
from numba.core.event import Event, Listener, install_listener

from granular.shared.files import (
    read_sealed_file,
    toolkit_cache_folder,
    trusted_cache_folder,
    write_sealed_file,
)

PACKAGE = Path(__file__).parent.parent
FOLDERS = ("compiled", "effects", "engine", "formulas", "kernel_data", "pairs", "protocol")
"""Folders of the package that contain all kernels, and all code that kernels use."""

_KERNEL = re.compile(rb"^\s*@(compiled|entry|intrinsic)\b", re.MULTILINE)


def read_compiled_sources() -> dict[str, bytes]:
    """Return the content of every file in `FOLDERS` by its path in the package."""
    paths = sorted(path for folder in FOLDERS for path in (PACKAGE / folder).rglob("*.py"))
    return {path.relative_to(PACKAGE).as_posix(): path.read_bytes() for path in paths}


def digest_of_file_contents(files: dict[str, bytes]) -> str:
    """Return a digest of the complete content of files, including comments."""
    digest = hashlib.sha256()
    for name, content in files.items():
        digest.update(f"{name}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()


def digest_of_code_without_comments(files: dict[str, bytes]) -> str:
    """Return a digest of files with kernels and of the files they import, without comments and docstrings."""
    waiting = [name for name, content in files.items() if _KERNEL.search(content)]
    trees: dict[str, ast.Module] = {}
    while waiting:
        name = waiting.pop()
        if name not in trees:
            trees[name] = ast.parse(files[name])
            waiting += [other for other in _remove_docstrings_and_list_imports(trees[name]) if other in files]
    digest = hashlib.sha256()
    for name in sorted(trees):
        digest.update(f"{name}\0".encode())
        digest.update(ast.dump(trees[name]).encode())
    return digest.hexdigest()


def _remove_docstrings_and_list_imports(tree: ast.Module) -> list[str]:
    """Remove docstrings from a file's tree; list the package's files from which the file may import."""
    imports: list[str] = []
    waiting: list[Any] = [tree]
    for node in waiting:
        if isinstance(node, ast.ImportFrom | ast.Import):
            imports += _imported_package_files(node)
        for part in ("body", "orelse", "finalbody", "handlers", "cases"):
            inner = getattr(node, part, [])
            inner[:] = [statement for statement in inner if not _is_docstring(statement)]
            waiting += inner
    return imports


def _imported_package_files(node: ast.ImportFrom | ast.Import) -> Iterator[str]:
    """Yield the files of this package from which a statement may import."""
    modules = [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        base = node.module or ""
        modules = [base, *(f"{base}.{name}" for name in modules)]
    for module in modules:
        package, *rest = module.split(".")
        if package == PACKAGE.name:
            path = "/".join(rest)
            yield from (f"{path}.py", f"{path}/__init__.py")


def _is_docstring(node: ast.stmt) -> bool:
    value = node.value if isinstance(node, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)


@functools.cache
def kernel_cache_folder() -> Path | None:
    """Return the folder of the kernels' cache, in ``NUMBA_CACHE_DIR`` or in the user's cache folder."""
    here = hashlib.sha256(f"{PACKAGE} {sys.implementation.cache_tag}".encode()).hexdigest()
    chosen = numba.config.CACHE_DIR
    home = Path(chosen) if chosen else toolkit_cache_folder()
    return trusted_cache_folder(home and home / f"kernels-{here[:16]}", "NUMBA_CACHE_DIR")


@functools.cache
def digest_of_kernel_dependencies() -> str:
    """Return a digest of all that determines the kernels' code, except argument types and processor."""
    files = read_compiled_sources()
    # Parsing takes a quarter of a second.
    syntax = read_or_compute_cached_text(
        "source", digest_of_file_contents(files), lambda: digest_of_code_without_comments(files)
    )
    versions = f"{sys.version} {sys.flags.optimize} {numba.__version__} {llvmlite.__version__}"
    return hashlib.sha256(f"{versions} {syntax}".encode()).hexdigest()


def read_or_compute_cached_text(name: str, label: str, compute: Callable[[], str]) -> str:
    """Return the text cached under a name and label, or compute and cache it."""
    folder = kernel_cache_folder()
    sealed = None if folder is None else read_sealed_file(folder / name, label)
    if sealed is not None:
        return sealed.decode()
    result = compute()
    if folder is not None:
        write_cache_file(folder / name, label, result.encode())
    return result


def write_cache_file(path: Path, label: str, body: bytes) -> None:
    """Write a cache file with its label and a checksum, or warn once if it cannot be written."""
    try:
        write_sealed_file(path, label, body)
    except OSError as error:
        _warn_once_that_code_is_not_cached(f"{path.parent} cannot be written: {error.strerror}")


@functools.cache
def _warn_once_that_code_is_not_cached(why: str) -> None:
    warnings.warn(f"compiled code is not cached: {why}; the next start compiles again", stacklevel=3)


@functools.cache
def _numba_cache_folder() -> Path | None:
    """Return the folder of Numba's cache for the present kernels; delete the folders of earlier kernels."""
    folder = kernel_cache_folder()
    if folder is None:
        return None
    current = folder / f"njit-{digest_of_kernel_dependencies()[:16]}"
    for former in folder.glob("njit-*"):
        if former != current:
            shutil.rmtree(former, ignore_errors=True)
    return current


def cache_kernel_by_numba(kernel: Any) -> None:
    """Store the compiled code of a kernel for Python, and of all kernels it calls, in Numba's cache."""
    folder, chosen = _numba_cache_folder(), numba.config.CACHE_DIR
    if folder is not None and "no_cpython_wrapper" not in kernel.targetoptions:
        numba.config.CACHE_DIR = str(folder)
        kernel.enable_caching()
        numba.config.CACHE_DIR = chosen


class CompileTimer(Listener):
    """Clock that measures how long its thread holds the lock of Numba's compiler."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self._thread, self._depth, self._begun = threading.get_ident(), 0, 0.0

    def on_start(self, event: Event) -> None:
        """Start the clock when the thread acquires the lock."""
        if threading.get_ident() == self._thread:
            if self._depth == 0:
                self._begun = time.perf_counter()
            self._depth += 1

    def on_end(self, event: Event) -> None:
        """Stop the clock when the thread releases the lock."""
        if threading.get_ident() == self._thread:
            self._depth -= 1
            if self._depth == 0:
                self.seconds += time.perf_counter() - self._begun


@contextlib.contextmanager
def measure_compile_time() -> Iterator[CompileTimer]:
    """Measure the time [s] of compiling or reading kernels within the block."""
    with install_listener("numba:compiler_lock", CompileTimer()) as timer:
        yield timer


class CompileReporter(Listener):
    """Counter of the kernels that its thread has started to compile, without kernels from the cache."""

    def __init__(self, report: Callable[[int], None]) -> None:
        self._report, self._thread, self._begun = report, threading.get_ident(), 0

    def on_start(self, event: Event) -> None:
        """Count a kernel at the start of its compilation, and report the number."""
        if threading.get_ident() == self._thread:
            self._begun += 1
            self._report(self._begun)

    def on_end(self, event: Event) -> None:
        """Do nothing at the end of a compilation."""
        pass


@contextlib.contextmanager
def report_compiled_kernels(report: Callable[[int], None]) -> Iterator[None]:
    """Whenever the block compiles a kernel, call ``report`` with the number compiled so far."""
    with install_listener("numba:compile", CompileReporter(report)):
        yield


SWITCH = "GRANULAR_PLAIN_NUMBA"
"""Environment variable that selects plain ``njit`` (1) or Numba's internals (0), whatever Numba's version."""

TESTED = (0, 64), (0, 68)
"""First and last tested version of Numba."""


def numba_internals_are_usable() -> bool:
    """Return True if kernels can be compiled with Numba internals; warn once if these are incompatible."""
    chosen = os.environ.get(SWITCH, "")
    if chosen:
        return chosen == "0"
    version = tuple(int(number) for number in re.findall(r"\d+", numba.__version__)[:2])
    if numba.config.DISABLE_JIT or TESTED[0] <= version <= TESTED[1]:
        return True
    fault = read_or_compute_cached_text(
        "insides", digest_of_kernel_dependencies(), _error_text_of_trial_kernels
    )
    if fault:
        tested = " to ".join(f"{major}.{minor}" for major, minor in TESTED)
        warnings.warn(
            f"numba {numba.__version__} is outside the tested versions, {tested}, and its internals are "
            f"incompatible ({fault}): kernels are compiled by njit, with the same results, but a first start "
            "takes twice as long",
            stacklevel=2,
        )
        os.environ[SWITCH] = "1"  # so that worker processes do not check and warn again
    return not fault


def _error_text_of_trial_kernels() -> str:
    """Return the error message of the trial kernels, or an empty text if they run."""
    # In a separate process, which incompatible code may terminate without an exception.
    path = os.pathsep.join(filter(None, [str(PACKAGE.parent), os.environ.get("PYTHONPATH")]))
    code = "from granular.compiled.trial_kernels import check_trial_kernels; check_trial_kernels()"
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, "-P", "-c", code],
            env={**os.environ, SWITCH: "0", "NUMBA_CACHE_DIR": folder, "PYTHONPATH": path},
            capture_output=True,
            text=True,
            check=False,
        )
    lines = done.stderr.strip().splitlines()
    return (lines or [f"exit code {done.returncode}"])[-1] if done.returncode else ""
