"""Tree of a parsed formula: numbers and names, and the operations on them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator

from granular.formulas.functions import CONSTANTS


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
