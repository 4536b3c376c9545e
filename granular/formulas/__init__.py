"""Formulas that people write, parsed into a tree. Nothing of a text is ever run.

A text is cut into tokens: numbers, names with their primes, and operators. Python's
parser, which runs nothing, orders stand-ins for them, and what it gives is taken over node by node
(`parser`), only what a formula may hold. Of the tree, `granular.formulas.algebra` makes
SymPy's objects, and `granular.formulas.algebra` its unit.
"""

from granular.formulas.parser import (
    CONSTANTS,
    FUNCTIONS,
    MAX_CHARACTERS,
    FormulaError,
    FormulaFunction,
    Name,
    Node,
    Number,
    Operation,
    constant_names,
    parse,
    variable_names,
)

__all__ = [
    "CONSTANTS",
    "FUNCTIONS",
    "MAX_CHARACTERS",
    "FormulaError",
    "FormulaFunction",
    "Name",
    "Node",
    "Number",
    "Operation",
    "constant_names",
    "parse",
    "variable_names",
]
