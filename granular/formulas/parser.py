"""Formulas parsed into trees: tokens put in order by Python's own parser, and checked."""

from __future__ import annotations

import ast
import bisect
import dataclasses
import itertools
import math
import re
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from granular.shared.errors import InputError, quote

CONSTANTS = {"pi": math.pi, "π": math.pi, "e": math.e}


class FormulaFunction(NamedTuple):
    """A function that a formula may name: of how many operands, and its value for numbers."""

    value: Callable[..., float]
    least: int = 1
    most: int = 1


def _sign(x: float) -> float:
    return float((x > 0.0) - (x < 0.0))


FUNCTIONS: Mapping[str, FormulaFunction] = {
    "exp": FormulaFunction(math.exp),
    "log": FormulaFunction(math.log),
    "sqrt": FormulaFunction(math.sqrt),
    "sin": FormulaFunction(math.sin),
    "cos": FormulaFunction(math.cos),
    "tan": FormulaFunction(math.tan),
    "asin": FormulaFunction(math.asin),
    "acos": FormulaFunction(math.acos),
    "atan": FormulaFunction(math.atan),
    "sinh": FormulaFunction(math.sinh),
    "cosh": FormulaFunction(math.cosh),
    "tanh": FormulaFunction(math.tanh),
    "abs": FormulaFunction(abs),
    "sign": FormulaFunction(_sign),
    "heaviside": FormulaFunction(lambda x: 0.5 + 0.5 * _sign(x)),
    "max": FormulaFunction(max, 2, 8),
    "min": FormulaFunction(min, 2, 8),
}
"""Functions by name; give `parse` a longer table where there are more."""

ALIASES = {"Abs": "abs", "Max": "max", "Min": "min", "Heaviside": "heaviside", "ln": "log"}
"""Names that SymPy prints for some of them, so that a printed equation can be read again."""


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


@dataclasses.dataclass(frozen=True, slots=True)
class Number:
    """A number as it was written, so that no digit is lost, or one of `CONSTANTS` by its name."""

    text: str


@dataclasses.dataclass(frozen=True, slots=True)
class Name:
    """A name with so many primes: ``z''`` has two."""

    name: str
    primes: int = 0

    @property
    def text(self) -> str:
        """Name with its primes."""
        return self.name + "'" * self.primes


@dataclasses.dataclass(frozen=True, slots=True)
class Operation:
    """Operator or function, applied to its operands."""

    head: str
    operands: tuple[Node, ...]


Node = Number | Name | Operation


def variable_names(*trees: Node) -> tuple[Name, ...]:
    """Names in formulas, each once, in the order of the text."""
    return tuple(dict.fromkeys(leaf for leaf in _iterate_leaves(trees) if isinstance(leaf, Name)))


def constant_names(*trees: Node) -> tuple[str, ...]:
    """Names of `CONSTANTS` in formulas, each once."""
    numbers = (leaf.text for leaf in _iterate_leaves(trees) if isinstance(leaf, Number))
    return tuple(dict.fromkeys(text for text in numbers if text in CONSTANTS))


def _iterate_leaves(trees: Iterable[Node]) -> Iterator[Name | Number]:
    for tree in trees:
        if isinstance(tree, Operation):
            yield from _iterate_leaves(tree.operands)
        else:
            yield tree


MAX_POWER = 64
"""A height of 1e-3 m to it is 1e-192: with a higher power formulas leave double precision."""
MAX_TERMS, MAX_SIZE = 300, 5000
"""Terms once all brackets are multiplied out, as SymPy does, and numbers and names in all of them:
within about a second."""


def parse(
    text: str, functions: Mapping[str, FormulaFunction] = FUNCTIONS, *, multiplied: bool = True
) -> Node:
    """Parse a formula."""
    return _Parser(tokenize(text, functions), functions, multiplied).parse_tree()


class _ParsedPart(NamedTuple):
    """A parsed part of a formula."""

    tree: Node
    value: float | None = None  # of numbers alone
    terms: float = 1.0  # once all brackets are multiplied out
    size: float = 1.0  # numbers and names in all of them


class _Parser:
    def __init__(
        self, tokens: list[Token], functions: Mapping[str, FormulaFunction], multiplied: bool
    ) -> None:
        self.tokens, self.functions, self.multiplied = tokens, functions, multiplied
        # Each number and name is a stand-in of its own: nothing that was written reaches Python.
        words = {"number": "1", "name": "n"}
        pieces = [words.get(str(token.lastgroup), token[0].replace("^", "**")) for token in tokens]
        self.source = " ".join(pieces)
        self.starts = list(itertools.accumulate((len(piece) + 1 for piece in pieces[:-1]), initial=0))

    def parse_tree(self) -> Node:
        try:
            body = ast.parse(self.source, mode="eval").body
        except SyntaxError as error:
            raise self._unreadable_error((error.offset or 1) - 1) from None
        except (ValueError, MemoryError, RecursionError):
            raise nesting_error(self.tokens[0]) from None
        return self._parse_part(body, 0).tree

    def _token_at(self, offset: int) -> Token:
        return self.tokens[max(0, bisect.bisect_right(self.starts, offset) - 1)]

    def _unreadable_error(self, offset: int) -> FormulaError:
        opened = sum((token[0] == "(") - (token[0] == ")") for token in self.tokens)
        if opened > 0:
            return FormulaError("a bracket is not closed; write )")
        if opened < 0:
            return FormulaError("a bracket closes that was not opened; write (")
        token = self._token_at(offset)
        return syntax_error(token, "what is no formula", "write one, such as k*(z - rest)")

    def _parse_part(self, node: ast.expr, depth: int) -> _ParsedPart:
        token = self._token_at(node.col_offset)
        if depth > MAX_DEPTH:
            raise nesting_error(token)
        operands: list[ast.expr]
        match node:
            case ast.Name():
                return self._parse_name(token)
            case ast.Constant(value=int()):
                return _ParsedPart(Number(token[0]), float(token[0]))
            case ast.UnaryOp(op=ast.UAdd()):
                return self._parse_part(node.operand, depth + 1)
            case ast.UnaryOp(op=ast.USub()):
                head, operands = "-", [node.operand]
            case ast.BinOp(op=ast.Add() | ast.Sub()):
                return self._parse_sum(node, depth, token)
            case ast.BinOp(op=ast.Mult()):
                head, operands = "*", [factor for factor, _ in _operands_in_order(node, ast.Mult)]
            case ast.BinOp(op=ast.Div() | ast.Pow()):
                head, operands = "/" if isinstance(node.op, ast.Div) else "**", [node.left, node.right]
            case ast.Call(func=ast.Name(), keywords=[]):
                head, operands = self._check_function_call(node, token), node.args
            case _:
                raise self._unreadable_error(node.col_offset)
        return self._apply_operation(
            head, [self._parse_part(operand, depth + 1) for operand in operands], token
        )

    def _parse_name(self, token: Token) -> _ParsedPart:
        text = token[0]
        if resolve_function_name(text, self.functions) is not None:
            remedy = f"write {text}(...), or take another name"
            raise syntax_error(token, f"{text!r} is a function", remedy)
        if text in CONSTANTS:
            return _ParsedPart(Number(text), CONSTANTS[text])
        name = text.rstrip("'")
        return _ParsedPart(Name(name, len(text) - len(name)))

    def _parse_sum(self, node: ast.expr, depth: int, token: Token) -> _ParsedPart:
        """All terms of a sum side by side: a long one is not a deep one."""
        terms = []
        for operand, operator in _operands_in_order(node, ast.Add, ast.Sub):
            term = self._parse_part(operand, depth + 1)
            subtracted = isinstance(operator, ast.Sub)
            terms.append(self._apply_operation("-", [term], token) if subtracted else term)
        return self._apply_operation("+", terms, token)

    def _check_function_call(self, node: ast.Call, token: Token) -> str:
        name = resolve_function_name(token[0], self.functions)
        assert name is not None  # the tokens were checked
        least, most = self.functions[name].least, self.functions[name].most
        if not least <= len(node.args) <= most:
            wanted = str(least) if least == most else f"{least} to {most}"
            what = f"{token[0]} of {len(node.args)} operands"
            raise syntax_error(token, what, f"{wanted} are wanted")
        return name

    def _apply_operation(self, head: str, parts: list[_ParsedPart], token: Token) -> _ParsedPart:
        """Operator or a function applied to its operands, if that can be computed."""
        if head == "**" and abs(parts[1].value or 0.0) > MAX_POWER:
            remedy = f"at most {MAX_POWER} is computed: write a lower one"
            raise syntax_error(token, f"a power of {parts[1].value:.3g}", remedy)
        if head == "/" and parts[1].value == 0.0:
            raise syntax_error(token, "a division by zero", "write another denominator")
        value = self._constant_result(head, parts, token)
        # Also of numbers: SymPy keeps roots as they are, and multiplies them out.
        terms, size = _count_expanded_terms(head, parts)
        if self.multiplied and (terms > MAX_TERMS or size > MAX_SIZE):
            what = f"{terms:.3g} terms ({size:.3g} numbers and names) when multiplied out"
            remedy = (
                f"at most {MAX_TERMS} ({MAX_SIZE}) are taken: write lower powers, or products of fewer sums"
            )
            raise syntax_error(token, what, remedy)
        return _ParsedPart(Operation(head, tuple(part.tree for part in parts)), value, terms, size)

    def _constant_result(self, head: str, parts: list[_ParsedPart], token: Token) -> float | None:
        """Value of an operation on numbers alone; None of any other."""
        numbers = [part.value for part in parts if part.value is not None]
        if len(numbers) < len(parts):
            return None
        try:
            compute = _OPERATORS.get(head) or self.functions[head].value
            value = compute(*numbers)
        except OverflowError:
            value = math.inf
        except (ValueError, ZeroDivisionError):
            value = math.nan
        if isinstance(value, complex) or math.isnan(value):
            raise syntax_error(token, "something that is no real number", "write another one")
        check_magnitude(value, token)
        return float(value)


_OPERATORS: Mapping[str, Callable[..., Any]] = {
    "+": lambda *numbers: math.fsum(numbers),
    "*": lambda *numbers: math.prod(numbers),
    "-": lambda number: -number,
    "/": lambda left, right: left / right,
    "**": lambda base, power: base**power,
}


def _operands_in_order(
    node: ast.expr, *operators: type[ast.operator]
) -> list[tuple[ast.expr, ast.operator | None]]:
    """Operands of a run of operators of one rank, from the left, each with that before it."""
    operands: list[tuple[ast.expr, ast.operator | None]] = []
    while isinstance(node, ast.BinOp) and isinstance(node.op, operators):
        operands.append((node.right, node.op))
        node = node.left
    return [(node, None), *reversed(operands)]


def _count_expanded_terms(head: str, parts: list[_ParsedPart]) -> tuple[float, float]:
    """Terms once all brackets are multiplied out, and numbers and names in all of them."""
    terms, sizes = [part.terms for part in parts], [part.size for part in parts]
    if head in ("+", "-"):
        return sum(terms), sum(sizes)
    if head == "*":
        # Each term of a product holds a term of every factor.
        count = math.prod(terms)
        return count, count * sum(size / term for size, term in zip(sizes, terms, strict=True))
    if head == "/":
        return terms[0], sizes[0] + terms[0] * sizes[1]
    if head == "**" and parts[1].value is not None:
        power = math.ceil(abs(parts[1].value))
        # Monomials of this degree in so many letters.
        count = float(math.comb(int(terms[0]) + power - 1, power))
        return count, count * (1.0 + min(power, terms[0]) * sizes[0] / terms[0])
    return 1.0, 1.0 + sum(sizes)
