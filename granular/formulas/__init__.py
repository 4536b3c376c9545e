"""Formulas that people write, read into a tree. Nothing of a text is ever run.

A text is cut into numbers, names with their primes, and signs, and each name stands as a number of
its own before Python's parser orders them (which reads, and runs nothing). What the parser gives is
taken over node by node, and only what a formula may hold. Whoever needs a formula makes of the tree
what suits: `granular.formulas.algebra` makes SymPy's objects.
"""

from granular.formulas.functions import CONSTANTS, FUNCTIONS, Function
from granular.formulas.reading import GREATEST_POWER, MOST_SIZE, MOST_TERMS, parse
from granular.formulas.tree import Applied, Name, Node, Number, constants, names
from granular.formulas.words import (
    LARGEST,
    MOST_DEPTH,
    MOST_DIGITS,
    MOST_LETTERS,
    MOST_SIGNS,
    MOST_WORDS,
    FormulaError,
)

__all__ = [
    "CONSTANTS",
    "FUNCTIONS",
    "GREATEST_POWER",
    "LARGEST",
    "MOST_DEPTH",
    "MOST_DIGITS",
    "MOST_LETTERS",
    "MOST_SIGNS",
    "MOST_SIZE",
    "MOST_TERMS",
    "MOST_WORDS",
    "Applied",
    "FormulaError",
    "Function",
    "Name",
    "Node",
    "Number",
    "constants",
    "names",
    "parse",
]
