"""The dimension of a formula: powers of metre, kilogram, second and ampere."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction

from granular.formulas import Name, Node, Number, Operation
from granular.shared.errors import InputError

Dimension = tuple[Fraction, ...]

BASE = ("m", "kg", "s", "A")
NONE: Dimension = (Fraction(0),) * len(BASE)
LENGTH, TIME, MASS, MOMENT = (
    tuple(map(Fraction, powers)) for powers in ((1, 0, 0, 0), (0, 0, 1, 0), (0, 1, 0, 0), (2, 0, 0, 1))
)
_SAME = {"+", "-", "max", "min", "abs"}


def unit_text(dimension: Dimension) -> str:
    """Dimension as the unit that has it: ``kg s^-2``; ``1`` without one."""
    parts = [
        name if power == 1 else f"{name}^{power}"
        for name, power in zip(BASE, dimension, strict=True)
        if power
    ]
    return " ".join(parts) or "1"


def infer_dimension(tree: Node, known: Mapping[str, Dimension]) -> Dimension:
    """Infer the dimension of a formula from those of its names."""
    if isinstance(tree, Name):
        return known[tree.text]
    if isinstance(tree, Number):
        return NONE
    parts = [infer_dimension(operand, known) for operand in tree.operands]
    if tree.head in _SAME:
        return _dimension_of_equal_terms(tree, parts)
    if tree.head == "*":
        return tuple(sum(powers, Fraction(0)) for powers in zip(*parts, strict=True))
    if tree.head == "/":
        return tuple(above - below for above, below in zip(*parts, strict=True))
    if tree.head == "sqrt":
        return tuple(power / 2 for power in parts[0])
    if tree.head == "**":
        return _dimension_of_power(tree, parts)
    if tree.head not in ("sign", "heaviside") and any(part != NONE for part in parts):
        unit = unit_text(next(part for part in parts if part != NONE))
        raise InputError(f"{tree.head} of something in {unit}; divide it by a size in {unit}")
    return NONE


def _dimension_of_equal_terms(tree: Operation, parts: list[Dimension]) -> Dimension:
    # A zero has every unit.
    result = [
        part for part, operand in zip(parts, tree.operands, strict=True) if _constant_value(operand) != 0
    ]
    for part in result[1:]:
        if part != result[0]:
            raise InputError(
                f"{unit_text(result[0])} and {unit_text(part)} are added or compared; check the "
                "units of the parameters"
            )
    return result[0] if result else NONE


def _dimension_of_power(tree: Operation, parts: list[Dimension]) -> Dimension:
    base, power = parts
    if power != NONE:
        raise InputError(f"a power in {unit_text(power)}; it must be a number")
    if base == NONE:
        return NONE
    number = _constant_value(tree.operands[1])
    if number is None:
        raise InputError(f"{unit_text(base)} to a power that is no plain number; write a number")
    return tuple(exponent * number for exponent in base)


def _constant_value(tree: Node) -> Fraction | None:
    """Value of a tree of plain numbers."""
    if isinstance(tree, Number):
        try:
            return Fraction(tree.text)
        except ValueError:
            return None
    if isinstance(tree, Operation):
        parts = [_constant_value(operand) for operand in tree.operands]
        known = [part for part in parts if part is not None]
        if len(known) == len(parts):
            if tree.head == "-":
                return -known[0]
            if tree.head == "/" and known[1]:
                return known[0] / known[1]
    return None
