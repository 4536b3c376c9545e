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

from granular.compiled.numba_insides import digest_of_sources, kernel_cache_folder, write_cache_file
from granular.shared.files import lock_file, read_sealed_file
from granular.shared.garbage import rare_garbage_collection


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
