"""User-written formulas, parsed into a tree. No part of a text is ever executed.

`granular.formulas.parser` splits a text into tokens: numbers, names with primes, and operators. Each token is
replaced by a placeholder, and Python's parser, which executes nothing, arranges the placeholders in a tree.
Only nodes that a formula may contain are accepted. `granular.formulas.algebra` converts the tree to SymPy and
infers the unit of the formula.
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
