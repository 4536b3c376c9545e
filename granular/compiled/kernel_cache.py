"""Compiled kernels on disk: compiled once, linked from each other, and read in a few milliseconds.

Numba's own cache looks at the file of the function that is called alone, keeps an index that two
processes may write simultaneously, names its files by line numbers, and loads whatever it finds.
Here

- one digest of all kernels' sources stands for them all, since kernels call each other: editing one
  compiles all afresh, and nothing stale is ever run;
- a file is loaded only if it is the user's own and whole (see `granular.shared.files`), and what
  cannot be written is not kept: the worst that a cache can do to a run is to cost it time.

Kernels that only kernels call are linked into their callers, and turned into code only there.

Numba optimises every function and writes its machine code, also where its code is put into a caller
and optimised there again, level by level; that took most of the time of a first start. Here a
kernel that only kernels call stays as it was lowered, and an entry takes in all kernels below it at
once.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import hashlib
import os
import pickle
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
from llvmlite import binding
from numba import _dynfunc
from numba.core.caching import NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult, compile_result
from numba.core.event import Event, Listener, install_listener
from numba.core.serialize import dumps

from granular.shared.files import (
    lock_file,
    read_sealed_file,
    toolkit_cache_folder,
    trusted_cache_folder,
    write_sealed_file,
)
from granular.shared.garbage import rare_garbage_collection

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


def _libraries_below(libraries: list[Any]) -> list[Any]:
    """Libraries and those that they link, each once, callers before what they call."""
    result: dict[Any, None] = {}

    def enter(library: Any) -> None:
        if library not in result:
            if isinstance(library, LinkedLibrary):
                for below in library._linking_libraries:
                    enter(below)
            result[library] = None

    for library in libraries:
        enter(library)
    return list(result)[::-1]


class LinkedLibrary(JITCodeLibrary):
    """Code of a kernel that is to be linked, neither optimised as a whole nor turned into code."""

    _linking_libraries: list[Any]
    _shared_module: Any

    def finalize(self) -> None:
        """Close the library without optimising it; its functions may be merged when it is linked."""
        self._raise_if_finalized()
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == binding.Linkage.external:
                function.linkage = "linkonce_odr"
        self._finalize_dynamic_globals()
        for library in self._linking_libraries:
            self._reload_init.update(library._reload_init)
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """Own code with all that it calls."""
        self._ensure_finalized()
        if self._shared_module is None:
            total = self._final_module.clone()
            for library in _libraries_below(self._linking_libraries):
                total.link_in(_module_to_link(library), preserve=True)
            self._shared_module = total
        return self._shared_module

    def serialize_using_object_code(self) -> tuple[str, str, bytes]:
        """Bitcode of the kernel with all that it calls, for the cache."""
        return self.name, "linked", self._get_module_for_linking().as_bitcode()


class EntryLibrary(JITCodeLibrary):
    """Code of a kernel that Python calls, with all kernels below it."""

    _linking_libraries: list[Any]

    def finalize(self) -> None:
        """Link in all kernels below, and turn all of it into machine code."""
        self._raise_if_finalized()
        for library in _libraries_below(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(_module_to_link(library), preserve=True)
        # Numba's own finalize would link them in a second time.
        self._linking_libraries = []
        super().finalize()


def _module_to_link(library: Any) -> Any:
    if isinstance(library, LinkedLibrary):
        return library._final_module
    return library._get_module_for_linking()


class InnerCompiler(Compiler):
    """Numba's compiler, up to what is to be linked."""

    def define_pipelines(self) -> Any:
        """Define Numba's stages of compiling, up to a library that is to be linked."""
        state = self.state
        if not state.flags.auto_parallel.enabled:
            codegen = state.targetctx.codegen()
            state.library = LinkedLibrary(codegen, state.func_id.func_qualname)
            state.flags.no_compile = True
        return super().define_pipelines()

    def _compile_core(self) -> Any:
        result = super()._compile_core()
        library = result.library
        if isinstance(library, LinkedLibrary):
            entry = _placeholder_entry_point(library, result.fndesc, result.environment)
            result = result._replace(entry_point=entry)
            result.target_context.insert_user_function(entry, result.fndesc, [library])
        return result


class EntryCompiler(Compiler):
    """Numba's compiler, with a library that takes in all kernels below."""

    def define_pipelines(self) -> Any:
        """Define Numba's stages of compiling, with a library that takes in the kernels below."""
        state = self.state
        codegen = state.targetctx.codegen()
        state.library = EntryLibrary(codegen, state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super().define_pipelines()

    def _compile_core(self) -> Any:
        with rare_garbage_collection():  # all kernels below are compiled in here
            return super()._compile_core()


def _placeholder_entry_point(library: Any, fndesc: Any, env: Any) -> Any:
    """Stand in for the kernel in Numba's tables; not to be called."""
    name = fndesc.qualname.split(".")[-1]
    return _dynfunc.make_function(fndesc.lookup_module(), name, "", 0, env, (library,))


def rebuild_kernel(context: Any, payload: tuple[Any, ...]) -> Any:
    """Rebuild the compiled form of a kernel from its file's content."""
    (name, kind, data), fndesc, env, signature, *rest = payload
    if kind != "linked":
        return CompileResult._rebuild(context, *payload)
    library = LinkedLibrary(context.codegen(), name)
    library._final_module = binding.parse_bitcode(data)
    library.finalize()
    library._shared_module = library._final_module
    return compile_result(
        target_context=context,
        typing_context=context.typing_context,
        library=library,
        environment=env,
        entry_point=_placeholder_entry_point(library, fndesc, env),
        fndesc=fndesc,
        type_annotation=rest[2],
        signature=signature,
        objectmode=False,
        lifted=rest[1],
        reload_init=rest[3],
        referenced_envs=rest[4],
    )


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
