"""The conditions that a method's coefficients must meet for an order of convergence.

A composition of kicks (K) and drifts (D) has order p where, for every word of up to p letters, the
product of its exponentials has the coefficient 1/n! that the exponential of h (K + D) has, n the
length of the word (Hairer, Lubich and Wanner 2006, III.5, doi:10.1007/3-540-30666-8). No word is
spared: with drag, or any other flow that goes with the kicks, the shorter lists of conditions for
kinetic energy that is quadratic in the momenta do not hold.

A Runge-Kutta method has order p where, for every rooted tree of up to p nodes, its elementary
weight is one over the tree's density (Hairer, Norsett and Wanner 1993, II.2,
doi:10.1007/978-3-540-78862-1).
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import TypeAlias

import numpy as np

# The tables here fail by 2e-15 at most; 1/10! is 3e-7.
TOLERANCE = 1e-10
"""Coefficients are printed with 12 digits or more, and the least condition checked is 1/10!."""

HIGHEST_ORDER = 10
"""Highest order whose conditions are checked: 2046 words, or 1842 trees."""

Tree: TypeAlias = "tuple[Tree, ...]"
"""A rooted tree: the trees that hang on its root."""


def failed_composition_condition(kicks: Sequence[float], drifts: Sequence[float], order: int) -> str | None:
    """First condition up to an order that a composition fails, in words."""
    result = _word_coefficients(kicks, drifts, order)
    for length in range(1, order + 1):
        wanted = 1.0 / math.factorial(length)
        off = np.abs(result[length] - wanted) > TOLERANCE
        if off.any():
            index = int(np.argmax(off))
            word = " ".join("KD"[index >> bit & 1] for bit in reversed(range(length)))
            return (
                f"order {length} needs 1/{math.factorial(length)} for the word {word} of kicks and "
                f"drifts, and these coefficients give {result[length][index]:.12g}"
            )
    return None


def failed_order_condition(tableau: Sequence[Sequence[float]], order: int) -> str | None:
    """First condition up to an order that a Runge-Kutta tableau (s + 1, s) fails, in words."""
    rows, weights = np.array(tableau[:-1]), np.array(tableau[-1])
    for nodes in range(1, order + 1):
        for tree in _rooted_trees(nodes):
            result = float(weights @ _stage_weights(tree, rows))
            if abs(result - 1.0 / _tree_density(tree)) > TOLERANCE:
                return (
                    f"order {nodes} needs 1/{_tree_density(tree)} for the tree {_tree_name(tree)}, "
                    f"and this tableau gives {result:.12g}"
                )
    return None


def _word_coefficients(kicks: Sequence[float], drifts: Sequence[float], order: int) -> list[np.ndarray]:
    """Coefficients of all words, by their length; a word's letters are bits, kicks 0, drifts 1."""
    result = [np.zeros(1 << length) for length in range(order + 1)]
    result[0][0] = 1.0
    durations = itertools.chain.from_iterable(itertools.zip_longest(kicks, drifts, fillvalue=0.0))
    for k, duration in enumerate(durations):
        if duration != 0.0:
            result = _multiply_by_exponential(result, k % 2, duration)
    return result


def _multiply_by_exponential(result: list[np.ndarray], letter: int, duration: float) -> list[np.ndarray]:
    """Coefficients after another exponential, of one letter's span, on the right."""
    made = []
    for length in range(len(result)):
        total = np.zeros(1 << length)
        for more in range(length + 1):
            last = (1 << more) - 1 if letter else 0
            # All words that end in ``more`` letters of this kind: their bits end in as many zeros or ones.
            total[last :: 1 << more] += duration**more / math.factorial(more) * result[length - more]
        made.append(total)
    return made


@functools.cache
def _rooted_trees(nodes: int) -> tuple[Tree, ...]:
    """All rooted trees of so many nodes, each once."""
    return tuple(_sets_of_trees(nodes - 1, nodes - 1))


def _sets_of_trees(nodes: int, largest: int) -> Iterator[Tree]:
    """All sets of trees with so many nodes together, none of them larger than ``largest``."""
    if nodes == 0:
        yield ()
        return
    for size in range(min(nodes, largest), 0, -1):
        for count in range(nodes // size, 0, -1):
            for same in itertools.combinations_with_replacement(_rooted_trees(size), count):
                for rest in _sets_of_trees(nodes - size * count, size - 1):
                    yield (*same, *rest)


def _node_count(tree: Tree) -> int:
    return 1 + sum(map(_node_count, tree))


def _tree_density(tree: Tree) -> int:
    return _node_count(tree) * math.prod(map(_tree_density, tree))


def _stage_weights(tree: Tree, rows: np.ndarray) -> np.ndarray:
    result = np.ones(len(rows))
    for child in tree:
        result = result * (rows @ _stage_weights(child, rows))
    return result


def _tree_name(tree: Tree) -> str:
    return "[" + "".join(map(_tree_name, tree)) + "]"
