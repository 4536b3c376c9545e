"""Named tuples that kernels hand on by reference.

A named tuple of some forty arrays is some two hundred numbers for a processor, and Numba hands on
every one of them at every call: calls cost more than they do, and each takes as long to compile as
a page of code. `by_reference` puts a named tuple in one place and gives its address. Kernels read
its fields as before; a field that is a named tuple is read by reference, too.
"""

from __future__ import annotations

import hashlib
from typing import Any

import numba
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import impl_ret_borrowed
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import intrinsic, lower_getattr_generic, models, register_model


class ReferenceType(types.Type):
    """Address of a named tuple; its name is short, since it is a part of names of kernels."""

    def __init__(self, total: Any) -> None:
        self.integer = total
        # 48 bits: of ten thousand types two clash with a chance of 2e-7.
        digest = hashlib.sha256(str(total).encode()).hexdigest()[:12]
        super().__init__(name=f"{total.instance_class.__name__}.{digest}")

    @property
    def mangling_args(self) -> tuple[str, tuple[()]]:
        """Name of the type in names of compiled kernels, without parameters."""
        return self.name, ()

    def field_position_and_type(self, name: str) -> tuple[int, Any] | None:
        """Position of a field, and the type that reading it gives."""
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
def _read_field(context: Any, builder: Any, kind: ReferenceType, value: Any, name: str) -> Any:
    output = kind.field_position_and_type(name)
    assert output is not None
    position, read = output
    pointer = cgutils.gep_inbounds(builder, value, 0, position)
    if isinstance(read, ReferenceType):
        return pointer
    block, before = builder.block, len(builder.block.instructions)
    result = context.data_model_manager[read].load_from_data_pointer(builder, pointer)
    # Fields never change, whatever is written to arrays: they are read once, before a loop.
    never = builder.module.add_metadata([])
    for instruction in block.instructions[before:]:
        if isinstance(instruction, ir.LoadInstr):
            instruction.set_metadata("invariant.load", never)
    return impl_ret_borrowed(context, builder, read, result)


def _store_fields(context: Any, builder: Any, kind: Any, value: Any, pointer: Any) -> None:
    """Write a value field by field."""
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
def _pass_by_reference(typing: Any, total: Any) -> Any:
    if not _is_named_tuple(total):
        return total(total), _cast_reference

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        workspace = context.data_model_manager[total].get_data_type()
        pointer = cgutils.alloca_once(builder, workspace)
        _store_fields(context, builder, total, values[0], pointer)
        # Behind what the optimiser cannot look through, the fields are as they are now.
        kind = ir.FunctionType(pointer.type, [pointer.type])
        return builder.asm(kind, "", "=r,0,~{memory}", [pointer], side_effect=True)

    return ReferenceType(total)(total), generate


by_reference: Any = (lambda total: total) if numba.config.DISABLE_JIT else _pass_by_reference
"""The address of a named tuple, good until the kernel returns; of anything else, that itself."""
