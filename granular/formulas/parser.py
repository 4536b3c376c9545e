"""Formulas parsed into trees: tokens put in order by Python's own parser, and checked."""

from __future__ import annotations

import ast
import bisect
import itertools
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from granular.formulas.functions import CONSTANTS, FUNCTIONS, FormulaFunction
from granular.formulas.tokens import (
    MAX_DEPTH,
    FormulaError,
    Token,
    check_magnitude,
    nesting_error,
    resolve_function_name,
    syntax_error,
    tokenize,
)
from granular.formulas.tree import Name, Node, Number, Operation

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
