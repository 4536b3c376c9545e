"""Kernels that only kernels call are linked into their callers, and turned into code only there.

Numba optimises every function and writes its machine code, also where its code is put into a caller
and optimised there again, level by level; that took most of the time of a first start. Here a
kernel that only kernels call stays as it was lowered, and an entry takes in all kernels below it at
once.
"""

from __future__ import annotations

from typing import Any

from llvmlite import binding
from numba import _dynfunc
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult, compile_result

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
