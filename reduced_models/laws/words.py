"""Laws from their equations alone, in the user's own words."""

from __future__ import annotations

from collections.abc import Collection

from granular import formulas
from granular.shared.errors import InputError
from granular.shared.messages import quoted
from reduced_models.laws.equation import trees_of
from reduced_models.laws.law import Law


def law_from_text(
    equation: str, columns: Collection[str] = (), declared: Collection[str] = ()
) -> Law:
    """A law from its equation alone; names that are columns of the record are its inputs.

    All other names are parameters. One that looks like a column or a constant, and is none, is
    refused unless it is among the ``declared`` parameters.

    Raises
    ------
    InputError
        If the text is no equation, has no parameter, or a name that looks like something else.
    """
    trees = trees_of(equation)
    law = f"the law {quoted(equation)}"
    for name in formulas.constants(*trees.all):
        if name in columns:
            raise InputError(
                f"{law} names {name}, a number, and the record has a column of that name; rename "
                "the column"
            )
    inputs = tuple(name for name in trees.names if name in columns and name != "z")
    found = Law(name=" ".join(equation.split()), equation=equation, inputs=inputs)
    for name in found.parameters:
        if name not in declared:
            _ask_about(law, name, columns)
    if not found.parameters:
        raise InputError(f"{law} has no parameter, so there is nothing to fit")
    return found


_MOTION = {
    "height": "z", "displacement": "z", "velocity": "z'", "speed": "z'", "acceleration": "z''",
    "time": "t",
}  # fmt: skip
_COLUMNS = ("force", "input", "drive", "load", "excitation", "voltage", "current", "temperature",
            "pressure", "torque")  # fmt: skip
_NUMBERS = ("pi", "e", "inf", "nan", "infinity")


def _ask_about(law: str, name: str, columns: Collection[str]) -> None:
    """Refuse a parameter whose name says that it is something else."""
    lower, near = name.lower(), {each.lower(): each for each in columns}
    declare = f"or declare the parameter, start={{{name!r}: ...}}"
    if lower in near:
        raise InputError(
            f"{law} names {name}, and the record has a column {near[lower]!r}; write that, "
            f"{declare}"
        )
    if name in _MOTION:
        raise InputError(f"{law} names {name}; write {_MOTION[name]} for it, {declare}")
    if lower in _COLUMNS:
        there = ", ".join(map(repr, columns)) or "none"
        raise InputError(
            f"{law} names {name}, which looks like a column, and the record has: {there}; add the "
            f"column, {declare}"
        )
    if lower in _NUMBERS and len(name) > 1:
        raise InputError(
            f"{law} names {name}, which looks like a number; write pi or e for those, {declare}"
        )
