"""User-written formulas, parsed into a tree. No part of a text is ever executed.

A text is split into tokens: numbers, names with primes, and operators. Python's parser, which
executes nothing, parses placeholders for them, and its result is converted node by node (`parser`);
only nodes that a formula may contain are accepted. `granular.formulas.algebra` converts the tree to
SymPy and infers its unit.
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
