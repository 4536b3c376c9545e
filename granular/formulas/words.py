"""The words of a formula: numbers, names and signs, each by itself and beside the one before."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from granular.formulas.functions import ALSO, CONSTANTS, Function
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
LARGEST = 1e100
"""Greatest size of a number, and one over the least: squares and cubes stay in double precision."""

# Letters that nobody takes for Latin ones; those that have a twin in Unicode stand for it.
_GREEK = "αβγδεζηθικλμνξπρστυφχψωΓΔΘΛΞΠΣΦΨΩ"
_TWINS = str.maketrans("µϕϵϑΩ", "μφεθΩ")
_PATTERN = re.compile(
    rf"(?P<space>[ \t\r\n]+)"
    rf"|(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
    rf"|(?P<name>[A-Za-z_{_GREEK}][A-Za-z0-9_{_GREEK}]*)(?P<primes>'*)"
    rf"|(?P<sign>\*\*|[-+*/^(),])"
)
_INSTEAD = {
    "−": "-", "–": "-", "×": "*", "·": "*", "⋅": "*", "÷": "/", "²": "**2", "³": "**3",
    "′": "'", "’": "'", "″": "''", '"': "''", "√": "sqrt", "[": "(", "]": ")", "{": "(", "}": ")",
}  # fmt: skip


class FormulaError(InputError):
    """A text is no formula; the message says what is not allowed, where, and what to write."""


class Word(NamedTuple):
    """A number, a name or a sign of a text."""

    kind: str
    text: str
    place: int
    primes: int = 0


class Words:
    """Those of one text, cut and checked."""

    def __init__(self, text: str, functions: Mapping[str, Function]) -> None:
        self.functions = functions
        if len(text) > MOST_SIGNS:
            raise FormulaError(
                f"{len(text)} characters are too long; at most {MOST_SIGNS} make a formula: write "
                "it shorter"
            )
        self.text = text.translate(_TWINS)
        self.all = list(self._words())
        self._check_words()

    def error(self, place: int, what: str, remedy: str) -> FormulaError:
        """What is wrong, the text from there on, and what to write."""
        rest = self.text[place : place + 20].strip()
        where = f"at {quoted(rest)}" if rest else "at the end"
        return FormulaError(f"{what} {where}; {remedy}")

    def _words(self) -> Iterator[Word]:
        place = 0
        while place < len(self.text):
            match = _PATTERN.match(self.text, place)
            if match is None:
                raise self._stranger(place)
            kind = "name" if match["name"] else str(match.lastgroup)
            if kind != "space":
                found = match["name"] or match[0]
                yield Word(kind, found, place, len(match["primes"] or ""))
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
        if not self.all:
            raise FormulaError("there is no formula; write one, such as k*z")
        if len(self.all) > MOST_WORDS:
            raise FormulaError(
                f"{len(self.all)} numbers, names and signs are too many; at most {MOST_WORDS} "
                "make a formula: write it shorter"
            )
        depth = run = 0
        before = None
        for word in self.all:
            self._check_word(word)
            if before is not None:
                self._check_pair(before, word)
            depth += (word.text == "(") - (word.text == ")")
            run = run + 1 if word.text in ("+", "-") else 0
            if max(depth, run) > MOST_DEPTH:
                raise self.too_deep(word.place)
            before = word

    def _check_word(self, word: Word) -> None:
        if word.kind == "number":
            if len(word.text) > MOST_DIGITS:
                raise self.error(
                    word.place, f"a number of {len(word.text)} signs",
                    f"at most {MOST_DIGITS} are read: round it",
                )  # fmt: skip
            self.check_size(float(word.text), word.place)
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
            if word.primes and (word.text in CONSTANTS or self.function(word) is not None):
                raise self.error(
                    word.place, f"a prime behind {word.text}, which does not change in time,",
                    "take another name",
                )  # fmt: skip

    def _check_pair(self, before: Word, word: Word) -> None:
        """Two operands beside each other, and calls of what is no function."""
        if before.text in ("(", ",") or (before.kind == "sign" and before.text != ")"):
            return
        if word.text == "(" and before.kind == "name":
            if self.function(before) is None:
                raise self.error(
                    before.place, f"{before.text!r} is no function", f"write {before.text}*(...), "
                    f"or one of {', '.join(self.functions)}",
                )  # fmt: skip
        elif word.text == "(" or word.kind != "sign":
            raise self.error(word.place, "a sign is missing", "write * between two factors")

    def function(self, word: Word) -> str | None:
        """The name of the function that a word stands for; None where it is none."""
        name = ALSO.get(word.text, word.text)
        return name if name in self.functions else None

    def too_deep(self, place: int) -> FormulaError:
        """The error of what lies deeper than can be read."""
        return self.error(
            place, f"more than {MOST_DEPTH} brackets, signs or powers within each other",
            "write it with fewer",
        )  # fmt: skip

    def check_size(self, value: float, place: int) -> None:
        """Raise `FormulaError` where a number leaves what double precision can square and cube."""
        if value and not 1.0 / LARGEST <= abs(value) <= LARGEST:
            raise self.error(
                place, f"a number of the size {abs(value):.3g}",
                f"it must be from {1.0 / LARGEST:g} to {LARGEST:g}: take other units",
            )  # fmt: skip
