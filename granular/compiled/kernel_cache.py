"""Cache of compiled kernels: compiled once, linked into each other, and read in a few milliseconds.

Numba's own cache has four faults. It checks only the file of the called function, has an index that two
processes may write simultaneously, names files by line numbers, and loads any file that it finds. In this
cache

- one digest of all kernels' sources identifies the code, because kernels call each other; after an edit of
  one kernel all are recompiled, and outdated code is never run;
- a file is loaded only if it belongs to the user and is intact (see `granular.shared.files`);
- a file that cannot be written costs compile time at the next start, but never changes results.

Kernels that only kernels call are linked into their callers, and machine code is generated only there. By
default, Numba optimises every function and generates its machine code, and then inlines the function into its
callers and optimises it again. This took most of the time of a first start. Here such a kernel remains
unoptimised LLVM code until a kernel for calls from Python links all kernels that it calls.
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
from llvmlite import binding
from numba import _dynfunc
from numba.core.caching import NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult, compile_result
from numba.core.serialize import dumps

from granular.compiled.numba_insides import (
    digest_of_kernel_dependencies,
    kernel_cache_folder,
    write_cache_file,
)
from granular.shared.files import lock_file, read_sealed_file
from granular.shared.garbage import rare_garbage_collection


def _libraries_and_linked_libraries(libraries: list[Any]) -> list[Any]:
    """List libraries and, recursively, the libraries that they link, each once, callers before callees."""
    result: dict[Any, None] = {}

    def append_after_linked_libraries(library: Any) -> None:
        if library not in result:
            if isinstance(library, LinkedLibrary):
                for below in library._linking_libraries:
                    append_after_linked_libraries(below)
            result[library] = None

    for library in libraries:
        append_after_linked_libraries(library)
    return list(result)[::-1]


class LinkedLibrary(JITCodeLibrary):
    """LLVM code of a kernel that is linked into its callers; it is not compiled to machine code."""

    _linking_libraries: list[Any]
    _shared_module: Any

    def finalize(self) -> None:
        """Finalize the library without optimisation, and allow the linker to merge its functions."""
        self._raise_if_finalized()
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == binding.Linkage.external:
                function.linkage = "linkonce_odr"
        self._finalize_dynamic_globals()
        for library in self._linking_libraries:
            self._reload_init.update(library._reload_init)
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """Return the module with the kernel and all its callees."""
        self._ensure_finalized()
        if self._shared_module is None:
            total = self._final_module.clone()
            for library in _libraries_and_linked_libraries(self._linking_libraries):
                total.link_in(_llvm_module_to_link(library), preserve=True)
            self._shared_module = total
        return self._shared_module

    def serialize_using_object_code(self) -> tuple[str, str, bytes]:
        """Return the bitcode of the kernel with all its callees, for the cache."""
        return self.name, "linked", self._get_module_for_linking().as_bitcode()


class EntryLibrary(JITCodeLibrary):
    """Machine code of a kernel for calls from Python, with all kernels that it calls."""

    _linking_libraries: list[Any]

    def finalize(self) -> None:
        """Link all called kernels, and generate machine code."""
        self._raise_if_finalized()
        for library in _libraries_and_linked_libraries(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(_llvm_module_to_link(library), preserve=True)
        # Numba's `finalize` would link the kernels below a second time.
        self._linking_libraries = []
        super().finalize()


def _llvm_module_to_link(library: Any) -> Any:
    if isinstance(library, LinkedLibrary):
        return library._final_module
    return library._get_module_for_linking()


class InnerCompiler(Compiler):
    """Numba's compiler without the last steps, whose result is a `LinkedLibrary`."""

    def define_pipelines(self) -> Any:
        """Define Numba's compiler passes, without the last ones."""
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
            entry = _make_placeholder_entry_point(library, result.fndesc, result.environment)
            result = result._replace(entry_point=entry)
            result.target_context.insert_user_function(entry, result.fndesc, [library])
        return result


class EntryCompiler(Compiler):
    """Numba's compiler, whose result is an `EntryLibrary`."""

    def define_pipelines(self) -> Any:
        """Define Numba's compiler passes."""
        state = self.state
        codegen = state.targetctx.codegen()
        state.library = EntryLibrary(codegen, state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super().define_pipelines()

    def _compile_core(self) -> Any:
        with rare_garbage_collection():  # all kernels below are compiled here
            return super()._compile_core()


def _make_placeholder_entry_point(library: Any, fndesc: Any, env: Any) -> Any:
    """Make a placeholder, which is never called, for the kernel in Numba's tables."""
    name = fndesc.qualname.split(".")[-1]
    return _dynfunc.make_function(fndesc.lookup_module(), name, "", 0, env, (library,))


def rebuild_kernel(context: Any, payload: tuple[Any, ...]) -> Any:
    """Restore the compiled code of a kernel from the content of its cache file."""
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
        entry_point=_make_placeholder_entry_point(library, fndesc, env),
        fndesc=fndesc,
        type_annotation=rest[2],
        signature=signature,
        objectmode=False,
        lifted=rest[1],
        reload_init=rest[3],
        referenced_envs=rest[4],
    )


ABANDONED = 86400.0
"""Age [s] after which a partially written file is taken as abandoned."""


@functools.cache
def _delete_outdated_files(folder: Path) -> None:
    """Delete cache files of earlier versions of the sources, and abandoned partial files."""
    stamp = digest_of_kernel_dependencies()[:16]
    with contextlib.suppress(OSError):
        for path in folder.iterdir():
            stale = path.suffix == ".kernel" and not path.stem.endswith(stamp)
            part = path.suffix in (".part", ".lock") and path.stat().st_mtime < time.time() - ABANDONED
            if stale or part:
                path.unlink(missing_ok=True)


PATIENCE = 60.0
"""Maximum time [s] to wait for code that another process is compiling."""
_LOOK = 0.02  # polling interval [s]

_claims: dict[Path, contextlib.ExitStack] = {}
"""Locks on the files whose code this process is compiling."""


def _read_kernel_file_or_claim(path: Path, label: str) -> bytes | None:
    """Return the content of a cache file, or None if this process must compile the code and write it."""
    latest = time.monotonic() + PATIENCE
    while (body := read_sealed_file(path, label)) is None and path not in _claims:
        claim = contextlib.ExitStack()
        try:
            claimed = claim.enter_context(lock_file(path.with_suffix(".lock"), wait=False))
        except OSError:  # the folder is not writable
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
    """Cache of one kernel's compiled code, with Numba's interface."""

    def __init__(self, function: Any, options: dict[str, Any]) -> None:
        self.name = f"{function.__module__}.{function.__qualname__}"
        self.options = repr(sorted(options.items()))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load the compiled code for given argument types."""
        target_context.refresh()
        entry = self._kernel_file_and_label(sig, target_context.codegen())
        body = None if entry is None else _read_kernel_file_or_claim(*entry)
        if body is None:
            return None
        try:
            types, payload = pickle.loads(body)
        except (ImportError, AttributeError):  # the modules of the kernel were renamed while it was compiled
            return None
        return rebuild_kernel(target_context, payload) if types == sig else None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write the compiled code for given argument types to its file."""
        entry = self._kernel_file_and_label(sig, data.codegen)
        if entry is None:
            return
        # Dynamic globals are addresses in this process, invalid in any other.
        if not data.library.has_dynamic_globals:
            _delete_outdated_files(entry[0].parent)
            write_cache_file(*entry, dumps((sig, data._reduce())))
        _release_claim(entry[0])

    def _kernel_file_and_label(self, sig: Any, codegen: Any) -> tuple[Path, str] | None:
        """Return cache file and required label for given argument types; None if there is no cache folder."""
        folder = kernel_cache_folder()
        if folder is None:
            return None
        stamp = digest_of_kernel_dependencies()
        checked = numba.config.BOUNDSCHECK  # bounds checks change the code
        label = f"{self.name} {self.options} {sig} {codegen.magic_tuple()} {checked} {stamp}"
        key = hashlib.sha256(label.encode()).hexdigest()
        # 64 bits of each digest suffice: a collision is harmless, since the label in the file is complete.
        return folder / f"{self.name}-{key[:16]}-{stamp[:16]}.kernel", label


def cache_kernel(kernel: Any) -> None:
    """Cache the compiled code of a kernel on disk."""
    kernel._cache = KernelCache(kernel.py_func, kernel.targetoptions)
