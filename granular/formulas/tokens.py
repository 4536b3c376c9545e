"""Tokens of a formula: numbers, names and operators, each checked alone and with its neighbour."""

from __future__ import annotations

import itertools
import re
import unicodedata
from collections.abc import Mapping

from granular.formulas.functions import ALIASES, CONSTANTS, FormulaFunction
from granular.shared.errors import InputError
from granular.shared.message_text import quote

MAX_CHARACTERS = 4000
"""Longest formula: five times the longest equation that a search has written."""
MAX_TOKENS = 600
"""Most tokens of a formula: three times those of a sum of all terms that `discover` knows."""
MAX_DEPTH = 50
"""Brackets and powers within each other: far from where Python's own recursion ends."""
MAX_NAME, MAX_DIGITS = 40, 40
"""Characters of a name, which still fits into a table, and of a number, twice what double
precision can tell apart."""
LARGEST = 1e100
"""Greatest size of a number, and one over the least: squares and cubes stay in double precision."""

Token = re.Match[str]

# Letters that nobody takes for Latin ones; those that have a twin in Unicode stand for it.
_GREEK = "αβγδεζηθικλμνξπρστυφχψωΓΔΘΛΞΠΣΦΨΩ"
_TWINS = str.maketrans("µϕϵϑΩ", "μφεθΩ")
_TOKEN = re.compile(
    r"(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
    rf"|(?P<name>[A-Za-z_{_GREEK}][A-Za-z0-9_{_GREEK}]*'*)"
    r"|(?P<operator>\*\*|[-+*/^(),])"
    r"|(?P<foreign>[^ \t\r\n])"
)
_INSTEAD = {
    "−": "-",
    "–": "-",
    "×": "*",
    "·": "*",
    "⋅": "*",
    "÷": "/",
    "²": "**2",
    "³": "**3",
    "′": "'",
    "’": "'",
    "″": "''",
    '"': "''",
    "√": "sqrt",
    "[": "(",
    "]": ")",
    "{": "(",
    "}": ")",
}


class FormulaError(InputError):
    """A text is no formula; the message says what is not allowed, where, and what to write."""


def tokenize(text: str, functions: Mapping[str, FormulaFunction]) -> list[Token]:
    """Cut a formula into its tokens."""
    if len(text) > MAX_CHARACTERS:
        raise FormulaError(
            f"{len(text)} characters are too long; at most {MAX_CHARACTERS} make a formula: write it shorter"
        )
    tokens = list(_TOKEN.finditer(text.translate(_TWINS)))
    for token in tokens:
        if token.lastgroup == "foreign":
            raise _foreign_character_error(token)
    if not tokens:
        raise FormulaError("there is no formula; write one, such as k*z")
    if len(tokens) > MAX_TOKENS:
        raise FormulaError(
            f"{len(tokens)} numbers, names and operators are too many; at most {MAX_TOKENS} make a "
            "formula: write it shorter"
        )
    depth = 0
    for token in tokens:
        _check_token(token, functions)
        depth += (token[0] == "(") - (token[0] == ")")
        if depth > MAX_DEPTH:
            raise nesting_error(token)
    for before, token in itertools.pairwise(tokens):
        _check_neighbouring_tokens(before, token, functions)
    return tokens


def _check_token(token: Token, functions: Mapping[str, FormulaFunction]) -> None:
    text = token[0]
    match token.lastgroup:
        case "number":
            if len(text) > MAX_DIGITS:
                what = f"a number of {len(text)} characters"
                raise syntax_error(token, what, f"at most {MAX_DIGITS} are read: round it")
            check_magnitude(float(text), token)
        case "name":
            name = text.rstrip("'")
            if len(name) > MAX_NAME:
                what = f"a name of {len(name)} letters"
                raise syntax_error(token, what, f"at most {MAX_NAME} make a name: shorten it")
            if "__" in name:
                what = "two underscores, characters that no name has together,"
                raise syntax_error(token, what, "write one")
            if name != text and (name in CONSTANTS or resolve_function_name(name, functions)):
                what = f"a prime behind {name}, which does not change in time,"
                raise syntax_error(token, what, "take another name")


def _check_neighbouring_tokens(before: Token, token: Token, functions: Mapping[str, FormulaFunction]) -> None:
    """Refuse two operands without an operator, and calls of what is no function."""
    if before.lastgroup == "operator" and before[0] != ")":
        return
    if token[0] == "(" and before.lastgroup == "name":
        if resolve_function_name(before[0], functions) is None:
            remedy = f"write {before[0]}*(...), or one of {', '.join(functions)}"
            raise syntax_error(before, f"{before[0]!r} is no function", remedy)
    elif token[0] == "(" or token.lastgroup != "operator":
        raise syntax_error(token, "a sign is missing", "write * between two factors")


def _foreign_character_error(token: Token) -> FormulaError:
    character = token[0]
    if character in _INSTEAD:
        remedy = f"write {_INSTEAD[character]}"
    elif character == "'":
        remedy = "a prime follows a name, as in z'"
    else:
        remedy = "write numbers, names, + - * / ** ( ) and functions"
    shown = quote(character)
    if not character.isascii():
        shown += f" ({unicodedata.name(character, 'nameless')})"
    return syntax_error(token, f"{shown} is none of the characters of a formula", remedy)


def resolve_function_name(name: str, functions: Mapping[str, FormulaFunction]) -> str | None:
    """Name of the function that a name stands for; None where it stands for none."""
    name = ALIASES.get(name, name)
    return name if name in functions else None


def syntax_error(token: Token, what: str, remedy: str) -> FormulaError:
    """Make the error that names what is wrong, the text from there on, and what to write."""
    rest = token.string[token.start() :][:20].strip()
    return FormulaError(f"{what} at {quote(rest)}; {remedy}")


def nesting_error(token: Token) -> FormulaError:
    """Make the error of what is nested deeper than is read."""
    what = f"more than {MAX_DEPTH} brackets, operators or powers within each other"
    return syntax_error(token, what, "write it with fewer")


def check_magnitude(value: float, token: Token) -> None:
    """Check that double precision can square and cube a number."""
    if value and not 1.0 / LARGEST <= abs(value) <= LARGEST:
        what = f"a number of the size {abs(value):.3g}"
        remedy = f"it must be from {1.0 / LARGEST:g} to {LARGEST:g}: take other units"
        raise syntax_error(token, what, remedy)
