"""Parser of formulas: Python's parser arranges the tokens in a tree, whose nodes are checked."""

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
    """A function for formulas: a Python function, and the minimum and maximum number of operands."""

    value: Callable[..., float]
    min_operands: int = 1
    max_operands: int = 1


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
"""Functions by name; `parse` can also be given an extended table."""

ALIASES = {"Abs": "abs", "Max": "max", "Min": "min", "Heaviside": "heaviside", "ln": "log"}
"""Names of functions in SymPy, accepted so that an equation printed by SymPy can be read."""


MAX_CHARACTERS = 4000
"""Maximum number of characters of a formula: five times the longest formula found in a search."""
MAX_TOKENS = 600
"""Maximum number of tokens of a formula: three times as many as in a sum of all terms of `discover`."""
MAX_DEPTH = 50
"""Maximum nesting depth of brackets and powers, far below Python's recursion limit."""
MAX_NAME, MAX_DIGITS = 40, 40
"""Maximum numbers of characters. Names of `MAX_NAME` characters fit into a table; `MAX_DIGITS`, for numbers,
is twice the number of digits of double precision."""
LARGEST = 1e100
"""Maximum magnitude of a number; the minimum is 1/`LARGEST`. Squares and cubes are then valid floats."""

Token = re.Match[str]

# Greek letters that differ from Latin ones; Unicode variants are replaced.
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
    """Error for a text that is not a formula; the message gives the fault, its position and a remedy."""


def tokenize(text: str, functions: Mapping[str, FormulaFunction]) -> list[Token]:
    """Split a formula into tokens."""
    if len(text) > MAX_CHARACTERS:
        raise FormulaError(
            f"the formula has {len(text)} characters, but the limit is {MAX_CHARACTERS}; write a shorter "
            "formula"
        )
    tokens = list(_TOKEN.finditer(text.translate(_TWINS)))
    for token in tokens:
        if token.lastgroup == "foreign":
            raise _foreign_character_error(token)
    if not tokens:
        raise FormulaError("the formula is empty; write one, such as k*z")
    if len(tokens) > MAX_TOKENS:
        raise FormulaError(
            f"the formula has {len(tokens)} numbers, names and operators, but the limit is {MAX_TOKENS}; "
            "write a shorter formula"
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
                problem = f"a number of {len(text)} characters"
                raise syntax_error(token, problem, f"the limit is {MAX_DIGITS}: round it")
            check_powers_within_float_range(float(text), token)
        case "name":
            name = text.rstrip("'")
            if len(name) > MAX_NAME:
                problem = f"a name of {len(name)} characters"
                raise syntax_error(token, problem, f"the limit is {MAX_NAME}: shorten it")
            if "__" in name:
                problem = "two consecutive underscores, not allowed in names,"
                raise syntax_error(token, problem, "write one")
            if name != text and (name in CONSTANTS or resolve_function_name(name, functions)):
                problem = f"a prime after {name}, which is constant in time,"
                raise syntax_error(token, problem, "use another name")


def _check_neighbouring_tokens(before: Token, token: Token, functions: Mapping[str, FormulaFunction]) -> None:
    """Reject two operands without an operator between them, and calls of names that are not functions."""
    if before.lastgroup == "operator" and before[0] != ")":
        return
    if token[0] == "(" and before.lastgroup == "name":
        if resolve_function_name(before[0], functions) is None:
            remedy = f"write {before[0]}*(...), or one of {', '.join(functions)}"
            raise syntax_error(before, f"{before[0]!r} is not a function", remedy)
    elif token[0] == "(" or token.lastgroup != "operator":
        raise syntax_error(token, "an operator is missing", "write * between two factors")


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
    return syntax_error(token, f"{shown} is not a character of formulas", remedy)


def resolve_function_name(name: str, functions: Mapping[str, FormulaFunction]) -> str | None:
    """Return the name of the function for a name or alias; None if there is no such function."""
    name = ALIASES.get(name, name)
    return name if name in functions else None


def syntax_error(token: Token, problem: str, remedy: str) -> FormulaError:
    """Make an error with the problem, the text at the position of the problem, and a remedy."""
    rest = token.string[token.start() :][:20].strip()
    return FormulaError(f"{problem} at {quote(rest)}; {remedy}")


def nesting_error(token: Token) -> FormulaError:
    """Make the error for nesting beyond `MAX_DEPTH`."""
    problem = f"more than {MAX_DEPTH} nested brackets, operators or powers"
    return syntax_error(token, problem, "write it with fewer")


def check_powers_within_float_range(value: float, token: Token) -> None:
    """Check that the square and cube of a number stay in the range of double precision."""
    if value and not 1.0 / LARGEST <= abs(value) <= LARGEST:
        problem = f"a number of magnitude {abs(value):.3g}"
        remedy = f"it must be from {1.0 / LARGEST:g} to {LARGEST:g}: use other units"
        raise syntax_error(token, problem, remedy)


@dataclasses.dataclass(frozen=True, slots=True)
class Number:
    """A number as text, to keep all digits, or the name of one of `CONSTANTS`."""

    text: str


@dataclasses.dataclass(frozen=True, slots=True)
class Name:
    """A name and its number of primes, such as two for ``z''``."""

    name: str
    primes: int = 0

    @property
    def text(self) -> str:
        """Name with its primes."""
        return self.name + "'" * self.primes


@dataclasses.dataclass(frozen=True, slots=True)
class Operation:
    """An operator or a function, with its operands."""

    head: str
    operands: tuple[Node, ...]


Node = Number | Name | Operation


def variable_names(*trees: Node) -> tuple[Name, ...]:
    """Names in formulas, without repetition, in the order of the text."""
    return tuple(dict.fromkeys(leaf for leaf in _iterate_names_and_numbers(trees) if isinstance(leaf, Name)))


def constant_names(*trees: Node) -> tuple[str, ...]:
    """Names of `CONSTANTS` in formulas, without repetition."""
    numbers = (leaf.text for leaf in _iterate_names_and_numbers(trees) if isinstance(leaf, Number))
    return tuple(dict.fromkeys(text for text in numbers if text in CONSTANTS))


def _iterate_names_and_numbers(trees: Iterable[Node]) -> Iterator[Name | Number]:
    for tree in trees:
        if isinstance(tree, Operation):
            yield from _iterate_names_and_numbers(tree.operands)
        else:
            yield tree


MAX_POWER = 64
"""Maximum exponent; 1e-3 m to this power is 1e-192, and higher powers would leave the range of floats."""
MAX_TERMS, MAX_SIZE = 300, 5000
"""Limits of a formula after SymPy has expanded all brackets: `MAX_TERMS` terms, which contain `MAX_SIZE`
numbers and names in total. Expansion then takes about a second."""


def parse(
    text: str, functions: Mapping[str, FormulaFunction] = FUNCTIONS, *, multiplied: bool = True
) -> Node:
    """Parse a formula."""
    return _Parser(tokenize(text, functions), functions, multiplied).parse_tree()


class _ParsedPart(NamedTuple):
    """A parsed part of a formula."""

    tree: Node
    value: float | None = None  # of constant expressions
    terms: float = 1.0  # after expansion of all brackets
    size: float = 1.0  # numbers and names in all terms


class _Parser:
    def __init__(
        self, tokens: list[Token], functions: Mapping[str, FormulaFunction], multiplied: bool
    ) -> None:
        self.tokens, self.functions, self.multiplied = tokens, functions, multiplied
        # Each number and name becomes a placeholder: no user text reaches Python's parser.
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
            return FormulaError("a closing bracket has no opening bracket; write (")
        token = self._token_at(offset)
        return syntax_error(token, "invalid syntax", "write a formula such as k*(z - rest)")

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
            remedy = f"write {text}(...), or use another name"
            raise syntax_error(token, f"{text!r} is a function", remedy)
        if text in CONSTANTS:
            return _ParsedPart(Number(text), CONSTANTS[text])
        name = text.rstrip("'")
        return _ParsedPart(Name(name, len(text) - len(name)))

    def _parse_sum(self, node: ast.expr, depth: int, token: Token) -> _ParsedPart:
        """Parse all terms of a sum at one level, so that a long sum is not deeply nested."""
        terms = []
        for operand, operator in _operands_in_order(node, ast.Add, ast.Sub):
            term = self._parse_part(operand, depth + 1)
            subtracted = isinstance(operator, ast.Sub)
            terms.append(self._apply_operation("-", [term], token) if subtracted else term)
        return self._apply_operation("+", terms, token)

    def _check_function_call(self, node: ast.Call, token: Token) -> str:
        name = resolve_function_name(token[0], self.functions)
        assert name is not None  # the tokens were checked
        function = self.functions[name]
        minimum, maximum = function.min_operands, function.max_operands
        if not minimum <= len(node.args) <= maximum:
            needed = str(minimum) if minimum == maximum else f"{minimum} to {maximum}"
            problem = f"{token[0]} with {len(node.args)} operands"
            raise syntax_error(token, problem, f"{needed} needed")
        return name

    def _apply_operation(self, head: str, parts: list[_ParsedPart], token: Token) -> _ParsedPart:
        """Apply an operator or a function to its operands; reject results that cannot be computed."""
        if head == "**" and abs(parts[1].value or 0.0) > MAX_POWER:
            remedy = f"the highest power is {MAX_POWER}: write a lower power"
            raise syntax_error(token, f"a power of {parts[1].value:.3g}", remedy)
        if head == "/" and parts[1].value == 0.0:
            raise syntax_error(token, "a division by zero", "write another denominator")
        value = self._value_of_operation_on_constants(head, parts, token)
        # Also for numbers, since SymPy keeps roots and expands them.
        terms, size = _count_expanded_terms_and_factors(head, parts)
        if self.multiplied and (terms > MAX_TERMS or size > MAX_SIZE):
            problem = f"{terms:.3g} terms ({size:.3g} numbers and names) when expanded"
            remedy = f"the limit is {MAX_TERMS} ({MAX_SIZE}): write lower powers, or products of fewer sums"
            raise syntax_error(token, problem, remedy)
        return _ParsedPart(Operation(head, tuple(part.tree for part in parts)), value, terms, size)

    def _value_of_operation_on_constants(
        self, head: str, parts: list[_ParsedPart], token: Token
    ) -> float | None:
        """Return the value of an operation on constants; None if an operand is not constant."""
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
            raise syntax_error(token, "a value that is not a real number", "write another formula")
        check_powers_within_float_range(value, token)
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
    """List the operands of a chain of operators of equal precedence, each with the operator before it."""
    operands: list[tuple[ast.expr, ast.operator | None]] = []
    while isinstance(node, ast.BinOp) and isinstance(node.op, operators):
        operands.append((node.right, node.op))
        node = node.left
    return [(node, None), *reversed(operands)]


def _count_expanded_terms_and_factors(head: str, parts: list[_ParsedPart]) -> tuple[float, float]:
    """Count the terms after expansion of all brackets, and the numbers and names in all terms."""
    terms, sizes = [part.terms for part in parts], [part.size for part in parts]
    if head in ("+", "-"):
        return sum(terms), sum(sizes)
    if head == "*":
        # Each term of a product contains a term of every factor.
        count = math.prod(terms)
        return count, count * sum(size / term for size, term in zip(sizes, terms, strict=True))
    if head == "/":
        return terms[0], sizes[0] + terms[0] * sizes[1]
    if head == "**" and parts[1].value is not None:
        power = math.ceil(abs(parts[1].value))
        # Number of monomials of this degree in this number of variables.
        count = float(math.comb(int(terms[0]) + power - 1, power))
        return count, count * (1.0 + min(power, terms[0]) * sizes[0] / terms[0])
    return 1.0, 1.0 + sum(sizes)
