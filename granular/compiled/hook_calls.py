"""Calls of effects' kernels by the compiled loop, and named tuples passed by reference.

An effect gives the loop its *law*, a named tuple of numbers and arrays. The class of the law has the effect's
kernels as static methods. Their names are *hooks*: the loop calls every kernel of a certain name at a certain
point. The active laws form a tuple. The kernels made here call a hook of each law in turn, as if the calls
were written out in the source. A law without the hook adds no code. Without the compiler, the calls are
resolved at run time.

A named tuple of forty arrays has about two hundred numbers, and Numba passes each of them in every call. Such
a call takes longer than the work of the called kernel, and is slow to compile.
`by_reference` stores a named tuple once and passes its address. Kernels read the fields as before; fields
that are named tuples are also passed by reference.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import operator
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numba
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import impl_ret_borrowed
from numba.core.typing import Signature, signature
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import intrinsic, lower_getattr_generic, models, register_model

Kernel = Callable[..., Any]

OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True, "forceinline": True}
"""Numba's options for a user's functions, the same as for `granular.compiled.compiled` with ``inline``."""


def make_hook_sum_kernel(hook: str, rest: str, empty: float = 0, *, backward: bool = False) -> Kernel:
    """Make a kernel ``(laws, workspaces, *rest)`` that calls a hook of each law and returns the sum."""
    return _make_hook_calls_kernel(hook, rest, slice(None, None, -1 if backward else 1), empty)


def make_hook_maximum_kernel(hook: str, rest: str) -> Kernel:
    """Make a kernel like `make_hook_sum_kernel` that returns the maximum, or 0 if no law has the hook."""
    return _make_hook_calls_kernel(hook, rest, slice(None), 0.0, max, _emit_maximum)


def make_last_hook_kernel(hook: str, rest: str, otherwise: Kernel) -> Kernel:
    """Make a kernel that calls the hook of the last law that has it, or ``otherwise`` if no law has it."""
    return _make_hook_calls_kernel(hook, rest, slice(-1, None), otherwise=otherwise)


def _make_hook_calls_kernel(
    hook: str,
    rest: str,
    called: slice,
    empty: float = 0,
    join: Kernel = operator.add,
    emit_join: Kernel | None = None,
    otherwise: Kernel | None = None,
) -> Kernel:
    """List the laws that have a hook; make a kernel that calls it for the slice ``called`` of the list."""

    def call(laws: Any, workspaces: Any, *others: Any) -> Any:
        indices = [index for index, law in enumerate(laws) if hasattr(law, hook)][called]
        if not indices:
            return empty if otherwise is None else otherwise(*others)
        results = (getattr(laws[k], hook)(laws[k], workspaces[k], k, *others) for k in indices)
        return functools.reduce(join, results)

    def signature_and_generator(
        context: Any, laws: Any, workspaces: Any, *others: Any
    ) -> tuple[Signature, Kernel]:
        indices = [index for index, law in enumerate(laws.types) if hasattr(law.instance_class, hook)]
        calls = [
            _resolve_hook_call(context, hook, laws, workspaces, index, others) for index in indices[called]
        ]
        if not calls and otherwise is not None:
            calls = [_resolve_kernel_call(context, otherwise, others, lambda *given: given[2][2:])]
        return _signature_and_generator_of_unrolled_calls(
            calls, empty, emit_join or _emit_sum, (laws, workspaces, *others)
        )

    return _make_intrinsic_wrapper(call, signature_and_generator, f"laws workspaces {rest}")


def make_hook_call_kernel(hook: str, rest: str, otherwise: Kernel) -> Kernel:
    """Make a kernel ``(law, *rest)`` that calls a law's hook, or ``otherwise`` if law or hook is missing."""

    def call(law: Any, *others: Any) -> Any:
        return getattr(law, hook, otherwise)(law, *others)

    def signature_and_generator(context: Any, law: Any, *others: Any) -> tuple[Signature, Kernel]:
        kernel = getattr(getattr(law, "instance_class", None), hook, otherwise)
        call_law = _resolve_kernel_call(context, kernel, (law, *others), lambda *given: given[2])
        return _signature_and_generator_of_unrolled_calls([call_law], 0, _emit_sum, (law, *others))

    return _make_intrinsic_wrapper(call, signature_and_generator, f"law {rest}")


class _KernelCall(NamedTuple):
    """A call of a kernel in compiled code."""

    kernel: Any
    sig: Signature
    given: Sequence[Any]  # types of its arguments
    take: Kernel  # (context, builder, values) -> arguments, from the arguments of the caller


def _resolve_kernel_call(context: Any, kernel: Kernel, given: Sequence[Any], take: Kernel) -> _KernelCall:
    known = context.resolve_value_type(kernel)
    return _KernelCall(known, known.get_call_type(context, tuple(given), {}), given, take)


def _resolve_hook_call(
    context: Any, hook: str, laws: Any, workspaces: Any, index: int, rest: Sequence[Any]
) -> _KernelCall:
    def take(context: Any, builder: Any, values: Sequence[Any]) -> list[Any]:
        own = [builder.extract_value(value, index) for value in values[:2]]
        return [*own, context.get_constant(types.int64, index), *values[2:]]

    kernel = getattr(laws.types[index].instance_class, hook)
    given = (laws.types[index], workspaces.types[index], types.int64, *rest)
    return _resolve_kernel_call(context, kernel, given, take)


def _emit_sum(builder: Any, first: Any, second: Any) -> Any:
    """Emit code that adds two numbers of the same type."""
    is_integer = isinstance(first.type, ir.IntType)
    return builder.add(first, second) if is_integer else builder.fadd(first, second)


def _emit_maximum(builder: Any, first: Any, second: Any) -> Any:
    return builder.select(builder.fcmp_ordered(">", first, second), first, second)


def _signature_and_generator_of_unrolled_calls(
    calls: Sequence[_KernelCall], empty: float, join: Kernel, given: tuple[Any, ...]
) -> tuple[Signature, Kernel]:
    """Return Numba's signature and code generator for successive calls whose results are combined."""
    none = types.float64 if isinstance(empty, float) else types.int64
    # Not a literal type: the sum of two results differs from the constant that the first call returns.
    result = types.unliteral(calls[0].sig.return_type) if calls else none

    def generate_calls(context: Any, builder: Any, sig: Signature, values: Sequence[Any]) -> Any:
        if not calls:
            return context.get_constant(none, empty)
        total = None
        for call in calls:
            output = _emit_call(context, builder, call, values)
            if result == types.none:
                total = context.get_dummy_value()
            else:
                output = context.cast(builder, output, call.sig.return_type, result)
                total = output if total is None else join(builder, total, output)
        return total

    return signature(result, *given), generate_calls


def _emit_call(context: Any, builder: Any, call: _KernelCall, values: Sequence[Any]) -> Any:
    arguments = [
        context.cast(builder, value, have, want)
        for value, have, want in zip(
            call.take(context, builder, values), call.given, call.sig.args, strict=True
        )
    ]
    function = context.get_function(call.kernel, call.sig)
    context.add_linking_libs(getattr(function, "libs", ()))
    return function(builder, arguments)


def _make_intrinsic_wrapper(call: Kernel, signature_and_generator: Any, names: str) -> Kernel:
    """Return a function with the given argument names that Python and kernels can call."""
    if numba.config.DISABLE_JIT:
        return call
    kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
    given = [inspect.Parameter(name, kind) for name in ("context", *names.split())]
    signature_and_generator.__signature__ = inspect.Signature(given)
    return intrinsic(signature_and_generator)


class ReferenceType(types.Type):
    """Numba type of a named tuple's address, with a short name, which appears in the names of kernels."""

    def __init__(self, total: Any) -> None:
        self.integer = total
        # 48 bits: the probability of a collision among ten thousand types is 2e-7.
        digest = hashlib.sha256(str(total).encode()).hexdigest()[:12]
        super().__init__(name=f"{total.instance_class.__name__}.{digest}")

    @property
    def mangling_args(self) -> tuple[str, tuple[()]]:
        """Short name of this type in the names of compiled kernels, without parameters."""
        return self.name, ()

    def field_position_and_type(self, name: str) -> tuple[int, Any] | None:
        """Return the position of a field and the type of its value, or None if there is no such field."""
        if name not in self.integer.fields:
            return None
        number = self.integer.fields.index(name)
        return number, _make_reference_type(self.integer.types[number])


def _make_reference_type(kind: Any) -> Any:
    return ReferenceType(kind) if _is_named_tuple(kind) else kind


def _is_named_tuple(kind: Any) -> bool:
    return isinstance(kind, types.BaseNamedTuple) and len(kind.types) > 0


@register_model(ReferenceType)
class _ReferenceModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: ReferenceType) -> None:
        data_type = manager.lookup(kind.integer).get_data_type()
        super().__init__(manager, kind, data_type.as_pointer())


@infer_getattr
class _ReferenceFields(AttributeTemplate):
    key = ReferenceType

    def generic_resolve(self, kind: ReferenceType, name: str) -> Any:
        result = kind.field_position_and_type(name)
        return None if result is None else result[1]


@lower_getattr_generic(ReferenceType)
def _read_field_of_reference(context: Any, builder: Any, kind: ReferenceType, value: Any, name: str) -> Any:
    output = kind.field_position_and_type(name)
    assert output is not None
    position, read = output
    pointer = cgutils.gep_inbounds(builder, value, 0, position)
    if isinstance(read, ReferenceType):
        return pointer
    block, before = builder.block, len(builder.block.instructions)
    result = context.data_model_manager[read].load_from_data_pointer(builder, pointer)
    # Fields are constant even if arrays are written to: the compiler may read them once, before a loop.
    never = builder.module.add_metadata([])
    for instruction in block.instructions[before:]:
        if isinstance(instruction, ir.LoadInstr):
            instruction.set_metadata("invariant.load", never)
    return impl_ret_borrowed(context, builder, read, result)


def _store_fields(context: Any, builder: Any, kind: Any, value: Any, pointer: Any) -> None:
    """Emit code that writes a value to memory field by field."""
    if _is_named_tuple(kind):
        for position, field_type in enumerate(kind.types):
            part = builder.extract_value(value, position)
            _store_fields(
                context, builder, field_type, part, cgutils.gep_inbounds(builder, pointer, 0, position)
            )
    else:
        builder.store(context.data_model_manager[kind].as_data(builder, value), pointer)


def _cast_reference(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    return impl_ret_borrowed(context, builder, signature.return_type, values[0])


@intrinsic
def _reference_to_named_tuple(typing: Any, total: Any) -> Any:
    if not _is_named_tuple(total):
        return total(total), _cast_reference

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        workspace = context.data_model_manager[total].get_data_type()
        pointer = cgutils.alloca_once(builder, workspace)
        _store_fields(context, builder, total, values[0], pointer)
        # An opaque instruction, so that the optimiser does not move stores of fields past it.
        kind = ir.FunctionType(pointer.type, [pointer.type])
        return builder.asm(kind, "", "=r,0,~{memory}", [pointer], side_effect=True)

    return ReferenceType(total)(total), generate


by_reference: Any = (lambda total: total) if numba.config.DISABLE_JIT else _reference_to_named_tuple
"""Return a named tuple's address, valid until the kernel returns; return other arguments unchanged."""
