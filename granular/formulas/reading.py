"""The order of a formula's words, made into its tree."""

from __future__ import annotations

import ast
import bisect
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from granular.formulas.functions import CONSTANTS, FUNCTIONS, Function
from granular.formulas.tree import Applied, Name, Node, Number
from granular.formulas.words import MOST_DEPTH, FormulaError, Word, Words

GREATEST_POWER = 64
"""A height of 1e-3 m to it is 1e-192: with a higher power formulas leave double precision."""
MOST_TERMS, MOST_SIZE = 300, 5000
"""Terms once all brackets are multiplied out, as SymPy does, and numbers and names in all of them:
within about a second."""


def parse(
    text: str, functions: Mapping[str, Function] = FUNCTIONS, *, multiplied: bool = True
) -> Node:
    """Read a formula.

    Numbers, names (Latin and Greek letters, digits, underscores), the constants ``pi`` and ``e``,
    ``+ - * / **`` (or ``^``), brackets, and functions.

    Parameters
    ----------
    text : str
    functions : mapping of str to Function
        Those that the formula may name.
    multiplied : bool
        Whether the formula will be multiplied out, so that one too large for it is refused.

    Raises
    ------
    FormulaError
        If it holds anything else, or is too large to be reckoned with.
    """
    return _Reader(Words(text, functions), multiplied).tree()


class _Reader:
    """Orders the words of one text."""

    def __init__(self, words: Words, multiplied: bool) -> None:
        self.words = words
        self.multiplied = multiplied
        self.starts: list[int] = []

    def tree(self) -> Node:
        """The tree of the whole text."""
        source = ""
        for index, word in enumerate(self.words.all):
            self.starts.append(len(source))
            stand_in = {"number": "1", "name": f"n{index}", "sign": word.text.replace("^", "**")}
            source += f"{stand_in[word.kind]} "
        try:
            body = ast.parse(source.rstrip(), mode="eval").body
        except SyntaxError as error:
            raise self._unreadable((error.offset or 1) - 1) from None
        except (ValueError, MemoryError, RecursionError):
            raise self.words.too_deep(0) from None
        return self._part(body, 0).tree

    def _word_at(self, offset: int) -> Word:
        """The word at an offset of what Python's parser was given."""
        return self.words.all[max(0, bisect.bisect_right(self.starts, offset) - 1)]

    def _unreadable(self, offset: int) -> FormulaError:
        opened = sum((word.text == "(") - (word.text == ")") for word in self.words.all)
        if opened > 0:
            return FormulaError("a bracket is not closed; write )")
        if opened < 0:
            return FormulaError("a bracket closes that was not opened; write (")
        place = self._word_at(offset).place
        return self.words.error(place, "what is no formula", "write one, such as k*(z - rest)")

    def _part(self, node: ast.expr, depth: int) -> _Part:
        word = self._word_at(node.col_offset)
        if depth > MOST_DEPTH:
            raise self.words.too_deep(word.place)
        match node:
            case ast.Name():
                return self._name(word)
            case ast.Constant(value=int()):
                return _Part(Number(word.text), float(word.text))
            case ast.UnaryOp(op=ast.UAdd()):
                return self._part(node.operand, depth + 1)
            case ast.UnaryOp(op=ast.USub()):
                return self._applied("-", [node.operand], depth, word)
            case ast.BinOp(op=ast.Add() | ast.Sub()):
                return self._sum(node, depth, word)
            case ast.BinOp(op=ast.Mult()):
                return self._applied("*", _factors(node), depth, word)
            case ast.BinOp(op=ast.Div()):
                return self._applied("/", [node.left, node.right], depth, word)
            case ast.BinOp(op=ast.Pow()):
                return self._applied("**", [node.left, node.right], depth, word)
            case ast.Call(func=ast.Name(), keywords=[]):
                return self._call(node, depth, word)
        raise self._unreadable(node.col_offset)

    def _name(self, word: Word) -> _Part:
        if self.words.function(word) is not None:
            raise self.words.error(
                word.place, f"{word.text!r} is a function",
                f"write {word.text}(...), or take another name",
            )  # fmt: skip
        if word.text in CONSTANTS:
            return _Part(Number(word.text), CONSTANTS[word.text])
        return _Part(Name(word.text, word.primes))

    def _sum(self, node: ast.expr, depth: int, word: Word) -> _Part:
        """All terms of a sum at once: a long one is not a deep one."""
        terms = []
        while isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub):
            term = self._part(node.right, depth + 1)
            negative = isinstance(node.op, ast.Sub)
            terms.append(self._checked("-", [term], word) if negative else term)
            node = node.left
        terms.append(self._part(node, depth + 1))
        return self._checked("+", terms[::-1], word)

    def _call(self, node: ast.Call, depth: int, word: Word) -> _Part:
        name = self.words.function(word)
        assert name is not None  # words before a bracket were checked
        least, most = self.words.functions[name].least, self.words.functions[name].most
        if not least <= len(node.args) <= most:
            wanted = str(least) if least == most else f"{least} to {most}"
            raise self.words.error(
                word.place, f"{word.text} of {len(node.args)} operands", f"{wanted} are wanted"
            )
        return self._applied(name, node.args, depth, word)

    def _applied(self, head: str, operands: list[ast.expr], depth: int, word: Word) -> _Part:
        parts = [self._part(operand, depth + 1) for operand in operands]
        return self._checked(head, parts, word)

    def _checked(self, head: str, parts: list[_Part], word: Word) -> _Part:
        """A sign or a function applied to its operands, if that can be reckoned with."""
        if head == "**" and abs(parts[1].value or 0.0) > GREATEST_POWER:
            raise self.words.error(
                word.place, f"a power of {parts[1].value:.3g}",
                f"at most {GREATEST_POWER} is reckoned with: write a lower one",
            )  # fmt: skip
        if head == "/" and parts[1].value == 0.0:
            raise self.words.error(word.place, "a division by zero", "write another denominator")
        value = self._value(head, parts, word)
        # Also of numbers: SymPy keeps roots as they are, and multiplies them out.
        terms, size = _multiplied_out(head, parts)
        if self.multiplied and (terms > MOST_TERMS or size > MOST_SIZE):
            raise self.words.error(
                word.place, f"{terms:.3g} terms ({size:.3g} numbers and names) when multiplied out",
                f"at most {MOST_TERMS} ({MOST_SIZE}) are taken: write lower powers, or products "
                "of fewer sums",
            )  # fmt: skip
        return _Part(Applied(head, tuple(part.tree for part in parts)), value, terms, size)

    def _value(self, head: str, parts: list[_Part], word: Word) -> float | None:
        """Of what holds numbers alone; None of anything else."""
        numbers = [part.value for part in parts if part.value is not None]
        if len(numbers) < len(parts):
            return None
        try:
            apply = _SIGNS[head] if head in _SIGNS else self.words.functions[head].value
            value = apply(*numbers)
        except OverflowError:
            value = math.inf
        except (ValueError, ZeroDivisionError):
            value = math.nan
        if isinstance(value, complex) or math.isnan(value):
            raise self.words.error(
                word.place, "something that is no real number", "write another one"
            )
        self.words.check_size(value, word.place)
        return float(value)


class _Part(NamedTuple):
    """A part of a formula as it is read.

    Attributes
    ----------
    tree : Node
    value : float or None
        Of a part that holds numbers alone.
    terms, size : float
        Terms once all brackets are multiplied out, and numbers and names in all of them.
    """

    tree: Node
    value: float | None = None
    terms: float = 1.0
    size: float = 1.0


_SIGNS: Mapping[str, Callable[..., Any]] = {
    "+": lambda *numbers: math.fsum(numbers),
    "*": lambda *numbers: math.prod(numbers),
    "-": lambda number: -number,
    "/": lambda left, right: left / right,
    "**": lambda base, power: base**power,
}


def _factors(node: ast.expr) -> list[ast.expr]:
    """The factors of a product, from the left."""
    found = []
    while isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
        found.append(node.right)
        node = node.left
    return [node, *reversed(found)]


def _multiplied_out(head: str, parts: list[_Part]) -> tuple[float, float]:
    """Terms once all brackets are multiplied out, and numbers and names in all of them."""
    terms, sizes = [part.terms for part in parts], [part.size for part in parts]
    if head in ("+", "-"):
        return sum(terms), sum(sizes)
    if head == "*":
        # Each term of a product holds a term of every factor.
        count = math.prod(terms)
        return count, count * sum(size / each for size, each in zip(sizes, terms, strict=True))
    if head == "/":
        return terms[0], sizes[0] + terms[0] * sizes[1]
    if head == "**" and parts[1].value is not None:
        power = math.ceil(abs(parts[1].value))
        count = float(math.comb(int(terms[0]) + power - 1, power))
        return count, count * (1.0 + min(power, terms[0]) * sizes[0] / terms[0])
    return 1.0, 1.0 + sum(sizes)
