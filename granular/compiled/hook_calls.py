"""Kernels that the types of laws choose when the loop is compiled.

An effect gives the loop its *law*: a named tuple of numbers and arrays, whose class has the
effect's kernels as static methods, by the names of the loop's *hooks*. The laws that act are a
tuple; what is made here calls a hook of each of them, one after another, as if the calls stood in
the source. A law without the hook leaves nothing in the code. Without the compiler the same is
chosen at every call.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numba
from llvmlite import ir
from numba import types
from numba.core.typing import Signature, signature
from numba.extending import intrinsic

Kernel = Callable[..., Any]

OPTIONS: dict[str, Any] = {
    "error_model": "numpy",
    "nogil": True,
    "fastmath": {"contract"},
    "forceinline": True,
}
"""Options for a user's functions: those of `granular.compiled.compiled` with ``inline``."""


def sum_of_hooks(hook: str, rest: str, empty: float = 0, *, backward: bool = False) -> Kernel:
    """Make a kernel ``(laws, workspaces, *rest)`` that adds up what a hook of each law returns."""

    def call(laws: Any, workspaces: Any, *others: Any) -> Any:
        result = [
            getattr(laws[index], hook)(laws[index], workspaces[index], index, *others)
            for index in _indices_of_laws_with_hook(hook, map(type, laws), backward)
        ]
        return sum(result[1:], start=result[0]) if result else empty

    def choose(context: Any, laws: Any, workspaces: Any, *others: Any) -> tuple[Signature, Kernel]:
        indices = _indices_of_laws_with_hook(hook, _law_classes(laws), backward)
        calls = [_resolve_hook_call(context, hook, laws, workspaces, index, others) for index in indices]
        return _emit_unrolled_calls(calls, empty, _emit_sum, (laws, workspaces, *others))

    return _make_intrinsic_wrapper(call, choose, f"laws workspaces {rest}")


def greatest_of_hooks(hook: str, rest: str) -> Kernel:
    """Make a kernel as of `sum_of_hooks`, for the greatest value; 0 where no law has the hook."""

    def call(laws: Any, workspaces: Any, *others: Any) -> Any:
        return max(
            (
                getattr(laws[index], hook)(laws[index], workspaces[index], index, *others)
                for index in _indices_of_laws_with_hook(hook, map(type, laws))
            ),
            default=0.0,
        )

    def choose(context: Any, laws: Any, workspaces: Any, *others: Any) -> tuple[Signature, Kernel]:
        indices = _indices_of_laws_with_hook(hook, _law_classes(laws))
        calls = [_resolve_hook_call(context, hook, laws, workspaces, index, others) for index in indices]
        return _emit_unrolled_calls(calls, 0.0, _emit_maximum, (laws, workspaces, *others))

    return _make_intrinsic_wrapper(call, choose, f"laws workspaces {rest}")


def call_last_hook(hook: str, rest: str, otherwise: Kernel) -> Kernel:
    """Make a kernel that calls the hook of the last law that has it; without one ``otherwise(*rest)``."""

    def call(laws: Any, workspaces: Any, *others: Any) -> Any:
        for index in _indices_of_laws_with_hook(hook, map(type, laws), backward=True):
            return getattr(laws[index], hook)(laws[index], workspaces[index], index, *others)
        return otherwise(*others)

    def choose(context: Any, laws: Any, workspaces: Any, *others: Any) -> tuple[Signature, Kernel]:
        indices = _indices_of_laws_with_hook(hook, _law_classes(laws), backward=True)[:1]
        calls = [_resolve_hook_call(context, hook, laws, workspaces, index, others) for index in indices]
        calls = calls or [_resolve_kernel_call(context, otherwise, others, range(2, 2 + len(others)))]
        return _emit_unrolled_calls(calls, 0, _emit_sum, (laws, workspaces, *others))

    return _make_intrinsic_wrapper(call, choose, f"laws workspaces {rest}")


def call_hook(hook: str, rest: str, otherwise: Kernel) -> Kernel:
    """Make a kernel ``(law, *rest)`` that calls a law's hook, or ``otherwise`` where it has none."""

    def call(law: Any, *others: Any) -> Any:
        return getattr(law, hook, otherwise)(law, *others)

    def choose(context: Any, law: Any, *others: Any) -> tuple[Signature, Kernel]:
        kernel = getattr(law.instance_class, hook, otherwise)
        call_law = _resolve_kernel_call(context, kernel, (law, *others), range(1 + len(others)))
        return _emit_unrolled_calls([call_law], 0, _emit_sum, (law, *others))

    return _make_intrinsic_wrapper(call, choose, f"law {rest}")


def _law_classes(laws: types.BaseTuple) -> list[type]:
    return [law.instance_class for law in laws.types]


def _indices_of_laws_with_hook(hook: str, classes: Any, backward: bool = False) -> list[int]:
    indices = [index for index, kind in enumerate(classes) if hasattr(kind, hook)]
    return indices[::-1] if backward else indices


class _KernelCall(NamedTuple):
    """A call of a kernel in compiled code."""

    kernel: Any
    sig: Signature
    sources: Sequence[int | tuple[int, int]]
    number: int | None


def _resolve_kernel_call(
    context: Any,
    kernel: Kernel,
    given: Sequence[Any],
    sources: Sequence[int | tuple[int, int]],
    number: int | None = None,
) -> _KernelCall:
    known = context.resolve_value_type(kernel)
    return _KernelCall(known, known.get_call_type(context, tuple(given), {}), sources, number)


def _resolve_hook_call(
    context: Any, hook: str, laws: Any, workspaces: Any, index: int, rest: Sequence[Any]
) -> _KernelCall:
    kernel = getattr(laws.types[index].instance_class, hook)
    given = (laws.types[index], workspaces.types[index], types.int64, *rest)
    sources = ((0, index), (1, index), *range(2, 2 + len(rest)))
    return _resolve_kernel_call(context, kernel, given, sources, index)


def _emit_sum(builder: Any, first: Any, second: Any) -> Any:
    """Sum of two numbers of one type."""
    is_integer = isinstance(first.type, ir.IntType)
    return builder.add(first, second) if is_integer else builder.fadd(first, second)


def _emit_maximum(builder: Any, first: Any, second: Any) -> Any:
    return builder.select(builder.fcmp_ordered(">", first, second), first, second)


def _emit_unrolled_calls(
    calls: Sequence[_KernelCall], empty: float, join: Kernel, given: tuple[Any, ...]
) -> tuple[Signature, Kernel]:
    """Return the calls, one after another, and what joins their results."""
    none = types.float64 if isinstance(empty, float) else types.int64
    # Not a literal: the sum of what two calls return is not what the first one always does.
    result = types.unliteral(calls[0].sig.return_type) if calls else none

    def write(context: Any, builder: Any, sig: Signature, values: Sequence[Any]) -> Any:
        if not calls:
            return context.get_constant(none, empty)
        total = None
        for call in calls:
            output = _emit_call(context, builder, call, values, given)
            if result == types.none:
                total = context.get_dummy_value()
            else:
                output = context.cast(builder, output, call.sig.return_type, result)
                total = output if total is None else join(builder, total, output)
        return total

    return signature(result, *given), write


def _emit_call(
    context: Any, builder: Any, call: _KernelCall, values: Sequence[Any], given: Sequence[Any]
) -> Any:
    arguments = []
    for source in call.sources:
        if isinstance(source, tuple):
            which, entry = source
            arguments.append((builder.extract_value(values[which], entry), given[which].types[entry]))
        else:
            arguments.append((values[source], given[source]))
    if call.number is not None:
        arguments.insert(2, (context.get_constant(types.int64, call.number), types.int64))
    cast = [
        context.cast(builder, value, have, want)
        for (value, have), want in zip(arguments, call.sig.args, strict=True)
    ]
    function = context.get_function(call.kernel, call.sig)
    context.add_linking_libs(getattr(function, "libs", ()))
    return function(builder, cast)


def _make_intrinsic_wrapper(call: Kernel, choose: Any, names: str) -> Kernel:
    """Return a function that plain Python or kernels call, with arguments of these names."""
    if numba.config.DISABLE_JIT:
        return call
    kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
    given = [inspect.Parameter(name, kind) for name in ("context", *names.split())]
    choose.__signature__ = inspect.Signature(given)
    return intrinsic(choose)
