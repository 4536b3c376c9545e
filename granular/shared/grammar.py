"""Formulas that people write, read into a tree. Nothing of a text is ever run.

A text is cut into numbers, names with their primes, and signs, and each name stands as a number of
its own before Python's parser orders them (which reads, and runs nothing). What the parser gives is
taken over node by node, and only what a formula may hold. Whoever needs a formula makes of the tree
what suits: `granular.shared.algebra` makes SymPy's objects.
"""

from __future__ import annotations

import ast
import bisect
import dataclasses
import math
import re
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from granular.shared.errors import InputError
from granular.shared.messages import quoted

MOST_SIGNS = 4000
"""Characters of a formula: five times the longest equation that a search has written."""
MOST_WORDS = 600
"""Numbers, names and signs: three times as many as a sum of all terms that `discover` knows has."""
MOST_DEPTH = 50
"""Brackets and powers within each other: far from where Python's own recursion ends."""
MOST_LETTERS = 40
"""Of a name: such a name still fits into a table."""
MOST_DIGITS = 40
"""Of a number: twice what double precision can tell apart."""
GREATEST_POWER = 64
"""A height of 1e-3 m to it is 1e-192: with a higher power formulas leave double precision."""
LARGEST = 1e100
"""Greatest size of a number, and one over the least: squares and cubes stay in double precision."""
MOST_TERMS, MOST_SIZE = 300, 5000
"""Terms once all brackets are multiplied out, as SymPy does, and numbers and names in all of them:
within about a second."""

CONSTANTS = {"pi": math.pi, "π": math.pi, "e": math.e}


class FormulaError(InputError):
    """A text is no formula; the message says what is not allowed, where, and what to write."""


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
        """As it is written."""
        return self.name + "'" * self.primes


@dataclasses.dataclass(frozen=True, slots=True)
class Applied:
    """A sign or a function, applied to its operands.

    Attributes
    ----------
    head : str
        ``"+"`` and ``"*"`` of two or more, ``"/"`` and ``"**"`` of two, ``"-"`` of one (the
        negative), or the name of a function.
    operands : tuple of Node
        In the order of the text.
    """

    head: str
    operands: tuple[Node, ...]


Node = Number | Name | Applied


class Function(NamedTuple):
    """A function that a formula may name: of how many operands, and its value for numbers."""

    value: Callable[..., float]
    least: int = 1
    most: int = 1


def _sign(x: float) -> float:
    return float((x > 0.0) - (x < 0.0))


FUNCTIONS: Mapping[str, Function] = {
    "exp": Function(math.exp),
    "log": Function(math.log),
    "sqrt": Function(math.sqrt),
    "sin": Function(math.sin),
    "cos": Function(math.cos),
    "tan": Function(math.tan),
    "asin": Function(math.asin),
    "acos": Function(math.acos),
    "atan": Function(math.atan),
    "sinh": Function(math.sinh),
    "cosh": Function(math.cosh),
    "tanh": Function(math.tanh),
    "abs": Function(abs),
    "sign": Function(_sign),
    "heaviside": Function(lambda x: 0.5 + 0.5 * _sign(x)),
    "max": Function(max, 2, 8),
    "min": Function(min, 2, 8),
}
"""Functions by name; give `parse` a longer table where there are more."""

_ALSO = {"Abs": "abs", "Max": "max", "Min": "min", "Heaviside": "heaviside", "ln": "log"}
"""How SymPy prints some of them, so that a printed equation can be read again."""

# Letters that nobody takes for Latin ones; those that have a twin in Unicode stand for it.
_GREEK = "αβγδεζηθικλμνξπρστυφχψωΓΔΘΛΞΠΣΦΨΩ"
_TWINS = str.maketrans("µϕϵϑΩ", "μφεθΩ")
_WORD = re.compile(
    rf"(?P<space>[ \t\r\n]+)"
    rf"|(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
    rf"|(?P<name>[A-Za-z_{_GREEK}][A-Za-z0-9_{_GREEK}]*)(?P<primes>'*)"
    rf"|(?P<sign>\*\*|[-+*/^(),])"
)
_INSTEAD = {
    "−": "-", "–": "-", "×": "*", "·": "*", "⋅": "*", "÷": "/", "²": "**2", "³": "**3",
    "′": "'", "’": "'", "″": "''", '"': "''", "√": "sqrt", "[": "(", "]": ")", "{": "(", "}": ")",
}  # fmt: skip


class _Word(NamedTuple):
    """A number, a name or a sign of a text."""

    kind: str
    text: str
    place: int
    primes: int = 0


def parse(text: str, functions: Mapping[str, Function] = FUNCTIONS) -> Node:
    """Read a formula.

    Numbers, names (Latin and Greek letters, digits, underscores), the constants ``pi`` and ``e``,
    ``+ - * / **`` (or ``^``), brackets, and functions.

    Parameters
    ----------
    text : str
    functions : mapping of str to Function
        Those that the formula may name.

    Raises
    ------
    FormulaError
        If it holds anything else, or is too large to be reckoned with.
    """
    return _Reader(text, functions).tree()


def names(*trees: Node) -> tuple[Name, ...]:
    """The names in formulas, each once, in the order of the text."""
    return tuple(dict.fromkeys(leaf for leaf in _leaves(trees) if isinstance(leaf, Name)))


def constants(*trees: Node) -> tuple[str, ...]:
    """Those of `CONSTANTS` that formulas name, each once."""
    numbers = (leaf.text for leaf in _leaves(trees) if isinstance(leaf, Number))
    return tuple(dict.fromkeys(text for text in numbers if text in CONSTANTS))


def _leaves(trees: Iterable[Node]) -> Iterator[Name | Number]:
    for tree in trees:
        if isinstance(tree, Applied):
            yield from _leaves(tree.operands)
        else:
            yield tree


class _Reader:
    """Reads one text."""

    def __init__(self, text: str, functions: Mapping[str, Function]) -> None:
        self.functions = functions
        if len(text) > MOST_SIGNS:
            raise FormulaError(
                f"{len(text)} characters are too long; at most {MOST_SIGNS} make a formula: write "
                "it shorter"
            )
        self.text = text.translate(_TWINS)
        self.words = list(self._words())
        self.starts: list[int] = []
        self._check_words()

    def error(self, place: int, what: str, remedy: str) -> FormulaError:
        """What is wrong, the text from there on, and what to write."""
        rest = self.text[place : place + 20].strip()
        where = f"at {quoted(rest)}" if rest else "at the end"
        return FormulaError(f"{what} {where}; {remedy}")

    # Words ------------------------------------------------------------------------------------

    def _words(self) -> Iterator[_Word]:
        place = 0
        while place < len(self.text):
            match = _WORD.match(self.text, place)
            if match is None:
                raise self._stranger(place)
            kind = "name" if match["name"] else str(match.lastgroup)
            if kind != "space":
                found = match["name"] or match[0]
                yield _Word(kind, found, place, len(match["primes"] or ""))
            place = match.end()

    def _stranger(self, place: int) -> FormulaError:
        sign = self.text[place]
        instead = _INSTEAD.get(sign)
        if instead is not None:
            remedy = f"write {instead}"
        elif sign == "'":
            remedy = "a prime follows a name, as in z'"
        else:
            remedy = "write numbers, names, + - * / ** ( ) and functions"
        shown = quoted(sign)
        if not sign.isascii():
            shown += f" ({unicodedata.name(sign, 'nameless')})"
        return self.error(place, f"{shown} is none of the characters of a formula", remedy)

    def _check_words(self) -> None:
        if not self.words:
            raise FormulaError("there is no formula; write one, such as k*z")
        if len(self.words) > MOST_WORDS:
            raise FormulaError(
                f"{len(self.words)} numbers, names and signs are too many; at most {MOST_WORDS} "
                "make a formula: write it shorter"
            )
        depth = run = 0
        before = None
        for word in self.words:
            self._check_word(word)
            if before is not None:
                self._check_pair(before, word)
            depth += (word.text == "(") - (word.text == ")")
            run = run + 1 if word.text in ("+", "-") else 0
            if max(depth, run) > MOST_DEPTH:
                raise self._too_deep(word.place)
            before = word

    def _check_word(self, word: _Word) -> None:
        if word.kind == "number":
            if len(word.text) > MOST_DIGITS:
                raise self.error(
                    word.place, f"a number of {len(word.text)} signs",
                    f"at most {MOST_DIGITS} are read: round it",
                )  # fmt: skip
            self._check_size(float(word.text), word.place)
        elif word.kind == "name":
            if len(word.text) > MOST_LETTERS:
                raise self.error(
                    word.place, f"a name of {len(word.text)} letters",
                    f"at most {MOST_LETTERS} make a name: shorten it",
                )  # fmt: skip
            if "__" in word.text:
                raise self.error(
                    word.place, "two underscores, characters that no name has together,",
                    "write one",
                )  # fmt: skip
            if word.primes and (word.text in CONSTANTS or self._function(word) is not None):
                raise self.error(
                    word.place, f"a prime behind {word.text}, which does not change in time,",
                    "take another name",
                )  # fmt: skip

    def _check_pair(self, before: _Word, word: _Word) -> None:
        """Two operands beside each other, and calls of what is no function."""
        if before.text in ("(", ",") or (before.kind == "sign" and before.text != ")"):
            return
        if word.text == "(" and before.kind == "name":
            if self._function(before) is None:
                raise self.error(
                    before.place, f"{before.text!r} is no function", f"write {before.text}*(...), "
                    f"or one of {', '.join(self.functions)}",
                )  # fmt: skip
        elif word.text == "(" or word.kind != "sign":
            raise self.error(word.place, "a sign is missing", "write * between two factors")

    def _function(self, word: _Word) -> str | None:
        """The name of the function that a word stands for; None where it is none."""
        name = _ALSO.get(word.text, word.text)
        return name if name in self.functions else None

    def _too_deep(self, place: int) -> FormulaError:
        return self.error(
            place, f"more than {MOST_DEPTH} brackets, signs or powers within each other",
            "write it with fewer",
        )  # fmt: skip

    def _check_size(self, value: float, place: int) -> None:
        if value and not 1.0 / LARGEST <= abs(value) <= LARGEST:
            raise self.error(
                place, f"a number of the size {abs(value):.3g}",
                f"it must be from {1.0 / LARGEST:g} to {LARGEST:g}: take other units",
            )  # fmt: skip

    # Tree -------------------------------------------------------------------------------------

    def tree(self) -> Node:
        """The tree of the whole text."""
        source = ""
        for index, word in enumerate(self.words):
            self.starts.append(len(source))
            stand_in = {"number": "1", "name": f"n{index}", "sign": word.text.replace("^", "**")}
            source += f"{stand_in[word.kind]} "
        try:
            body = ast.parse(source.rstrip(), mode="eval").body
        except SyntaxError as error:
            raise self._unreadable((error.offset or 1) - 1) from None
        except (ValueError, MemoryError, RecursionError):
            raise self._too_deep(0) from None
        return self._part(body, 0).tree

    def _word_at(self, offset: int) -> _Word:
        """The word at an offset of what Python's parser was given."""
        return self.words[max(0, bisect.bisect_right(self.starts, offset) - 1)]

    def _unreadable(self, offset: int) -> FormulaError:
        opened = sum((word.text == "(") - (word.text == ")") for word in self.words)
        if opened > 0:
            return FormulaError("a bracket is not closed; write )")
        if opened < 0:
            return FormulaError("a bracket closes that was not opened; write (")
        place = self._word_at(offset).place
        return self.error(place, "what is no formula", "write one, such as k*(z - rest)")

    def _part(self, node: ast.expr, depth: int) -> _Part:
        word = self._word_at(node.col_offset)
        if depth > MOST_DEPTH:
            raise self._too_deep(word.place)
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

    def _name(self, word: _Word) -> _Part:
        if self._function(word) is not None:
            raise self.error(
                word.place, f"{word.text!r} is a function",
                f"write {word.text}(...), or take another name",
            )  # fmt: skip
        if word.text in CONSTANTS:
            return _Part(Number(word.text), CONSTANTS[word.text])
        return _Part(Name(word.text, word.primes))

    def _sum(self, node: ast.expr, depth: int, word: _Word) -> _Part:
        """All terms of a sum at once: a long one is not a deep one."""
        terms = []
        while isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub):
            term = self._part(node.right, depth + 1)
            negative = isinstance(node.op, ast.Sub)
            terms.append(self._checked("-", [term], word) if negative else term)
            node = node.left
        terms.append(self._part(node, depth + 1))
        return self._checked("+", terms[::-1], word)

    def _call(self, node: ast.Call, depth: int, word: _Word) -> _Part:
        name = self._function(word)
        assert name is not None  # words before a bracket were checked
        least, most = self.functions[name].least, self.functions[name].most
        if not least <= len(node.args) <= most:
            wanted = str(least) if least == most else f"{least} to {most}"
            raise self.error(
                word.place, f"{word.text} of {len(node.args)} operands", f"{wanted} are wanted"
            )
        return self._applied(name, node.args, depth, word)

    def _applied(self, head: str, operands: list[ast.expr], depth: int, word: _Word) -> _Part:
        parts = [self._part(operand, depth + 1) for operand in operands]
        return self._checked(head, parts, word)

    def _checked(self, head: str, parts: list[_Part], word: _Word) -> _Part:
        """A sign or a function applied to its operands, if that can be reckoned with."""
        if head == "**" and abs(parts[1].value or 0.0) > GREATEST_POWER:
            raise self.error(
                word.place, f"a power of {parts[1].value:.3g}",
                f"at most {GREATEST_POWER} is reckoned with: write a lower one",
            )  # fmt: skip
        if head == "/" and parts[1].value == 0.0:
            raise self.error(word.place, "a division by zero", "write another denominator")
        value = self._value(head, parts, word)
        # Also of numbers: SymPy keeps roots as they are, and multiplies them out.
        terms, size = _multiplied_out(head, parts)
        if terms > MOST_TERMS or size > MOST_SIZE:
            raise self.error(
                word.place, f"{terms:.3g} terms ({size:.3g} numbers and names) when multiplied out",
                f"at most {MOST_TERMS} ({MOST_SIZE}) are taken: write lower powers, or products "
                "of fewer sums",
            )  # fmt: skip
        return _Part(Applied(head, tuple(part.tree for part in parts)), value, terms, size)

    def _value(self, head: str, parts: list[_Part], word: _Word) -> float | None:
        """Of what holds numbers alone; None of anything else."""
        numbers = [part.value for part in parts if part.value is not None]
        if len(numbers) < len(parts):
            return None
        try:
            apply = _SIGNS[head] if head in _SIGNS else self.functions[head].value
            value = apply(*numbers)
        except OverflowError:
            value = math.inf
        except (ValueError, ZeroDivisionError):
            value = math.nan
        if isinstance(value, complex) or math.isnan(value):
            raise self.error(word.place, "something that is no real number", "write another one")
        self._check_size(value, word.place)
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
