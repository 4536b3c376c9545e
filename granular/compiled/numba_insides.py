"""Parts of the kernels' cache that need none of Numba's insides, used before these are tried.

The digest of the kernels' sources, without comments and docstrings; the folder of compiled kernels, and
Numba's own cache in it; the time that is spent compiling; the trial of a version of Numba that was not
tested.
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
"""The folders of the package with the kernels and all that kernels take from other files."""

_KERNEL = re.compile(rb"^\s*@(compiled|entry|intrinsic)\b", re.MULTILINE)


def read_compiled_sources() -> dict[str, bytes]:
    """Content of every file in `FOLDERS`, by its path in the package."""
    paths = sorted(path for folder in FOLDERS for path in (PACKAGE / folder).rglob("*.py"))
    return {path.relative_to(PACKAGE).as_posix(): path.read_bytes() for path in paths}


def digest_of_bytes(files: dict[str, bytes]) -> str:
    """Digest of the files to the last byte."""
    digest = hashlib.sha256()
    for name, content in files.items():
        digest.update(f"{name}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()


def digest_of_syntax(files: dict[str, bytes]) -> str:
    """Digest of what the compiler sees of the files that hold kernels, or that these import from."""
    waiting = [name for name, content in files.items() if _KERNEL.search(content)]
    trees: dict[str, ast.Module] = {}
    while waiting:
        name = waiting.pop()
        if name not in trees:
            trees[name] = ast.parse(files[name])
            waiting += [other for other in _remove_docstrings(trees[name]) if other in files]
    digest = hashlib.sha256()
    for name in sorted(trees):
        digest.update(f"{name}\0".encode())
        digest.update(ast.dump(trees[name]).encode())
    return digest.hexdigest()


def _remove_docstrings(tree: ast.Module) -> list[str]:
    """Take out docstrings, and return the package's files that the file may import from."""
    imports: list[str] = []
    waiting: list[Any] = [tree]
    for node in waiting:
        if isinstance(node, ast.ImportFrom | ast.Import):
            imports += _imports_of(node)
        for part in ("body", "orelse", "finalbody", "handlers", "cases"):
            inner = getattr(node, part, [])
            inner[:] = [statement for statement in inner if not _is_docstring(statement)]
            waiting += inner
    return imports


def _imports_of(node: ast.ImportFrom | ast.Import) -> Iterator[str]:
    """Files of this package that a statement may import from."""
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


class CompileTimer(Listener):
    """Counts the time in which its thread holds the lock of Numba's compiler."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self._thread, self._depth, self._begun = threading.get_ident(), 0, 0.0

    def on_start(self, event: Event) -> None:
        """Start the clock where the thread takes the lock."""
        if threading.get_ident() == self._thread:
            if self._depth == 0:
                self._begun = time.perf_counter()
            self._depth += 1

    def on_end(self, event: Event) -> None:
        """Stop the clock where the thread gives the lock back."""
        if threading.get_ident() == self._thread:
            self._depth -= 1
            if self._depth == 0:
                self.seconds += time.perf_counter() - self._begun


@contextlib.contextmanager
def measure_compile_time() -> Iterator[CompileTimer]:
    """Measure the time in which kernels are compiled or read within the block [s]."""
    with install_listener("numba:compiler_lock", CompileTimer()) as timer:
        yield timer


class CompileReporter(Listener):
    """Tells how many kernels its thread has begun to compile; those from the cache do not count."""

    def __init__(self, report: Callable[[int], None]) -> None:
        self._report, self._thread, self._begun = report, threading.get_ident(), 0

    def on_start(self, event: Event) -> None:
        """Count a kernel whose compiling the thread begins, and report the number."""
        if threading.get_ident() == self._thread:
            self._begun += 1
            self._report(self._begun)

    def on_end(self, event: Event) -> None:
        """Do nothing where a kernel is done."""
        pass


@contextlib.contextmanager
def report_compiled_kernels(report: Callable[[int], None]) -> Iterator[None]:
    """Call a function with the number of each kernel that is compiled within the block."""
    with install_listener("numba:compile", CompileReporter(report)):
        yield


SWITCH = "GRANULAR_PLAIN_NUMBA"
"""Variable of the environment: 1 for Numba's own ``njit``, 0 for the insides, whatever the version."""

TESTED = (0, 64), (0, 68)
"""First and last version of Numba that the tests were run with."""


def insides_are_usable() -> bool:
    """Return whether kernels are compiled by Numba's insides; warn once where they no longer fit."""
    chosen = os.environ.get(SWITCH, "")
    if chosen:
        return chosen == "0"
    version = tuple(int(number) for number in re.findall(r"\d+", numba.__version__)[:2])
    if numba.config.DISABLE_JIT or TESTED[0] <= version <= TESTED[1]:
        return True
    fault = read_or_compute("insides", digest_of_sources(), _find_fault)
    if fault:
        tested = " to ".join(f"{major}.{minor}" for major, minor in TESTED)
        warnings.warn(
            f"numba {numba.__version__} is outside the tested versions, {tested}, and its insides do not "
            f"fit ({fault}): its own njit compiles, with the same results and a first start twice as long",
            stacklevel=2,
        )
        os.environ[SWITCH] = "1"  # worker processes need not find out, and warn, again
    return not fault


def _find_fault() -> str:
    """Return the error that stops the trial kernels; empty if they run."""
    # In a process of its own: code that does not fit may end one without an exception.
    path = os.pathsep.join(filter(None, [str(PACKAGE.parent), os.environ.get("PYTHONPATH")]))
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, "-P", "-c", "from granular.compiled.trial_kernels import run; run()"],
            env={**os.environ, SWITCH: "0", "NUMBA_CACHE_DIR": folder, "PYTHONPATH": path},
            capture_output=True,
            text=True,
            check=False,
        )
    lines = done.stderr.strip().splitlines()
    return (lines or [f"exit code {done.returncode}"])[-1] if done.returncode else ""
