"""Integration methods, defined by a table of coefficients that is checked against the method's order.

A composition of kicks (K) and drifts (D) is a product of exponentials of these operators. It has order p if
the coefficient of every word of up to p letters, such as KDK, is the same as in the exponential of h (K + D):
1/n! for a word of n letters (Hairer, Lubich and Wanner 2006, III.5, doi:10.1007/3-540-30666-8). All words are
checked. The shorter lists of conditions for a kinetic energy quadratic in the momenta are not sufficient with
drag, or any other dissipation that is solved with the kicks.

A Runge-Kutta method has order p if its elementary weight for every rooted tree of up to p nodes is one
divided by the tree's density (Hairer, Norsett and Wanner 1993, II.2, doi:10.1007/978-3-540-78862-1).
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from granular.shared.errors import InputError, quote

# The errors of the built-in tables are below 2e-15; 1/10! is 3e-7.
TOLERANCE = 1e-10
"""Tolerance of the order conditions; published coefficients have 12 or more digits."""

HIGHEST_ORDER = 10
"""Highest order that can be checked, which requires 2046 words or 1842 trees."""

Tree: TypeAlias = "tuple[Tree, ...]"
"""Rooted tree, represented by the tuple of the subtrees of its root."""


def failed_composition_condition(kicks: Sequence[float], drifts: Sequence[float], order: int) -> str | None:
    """Describe the first order condition that a composition fails, or return None."""
    result = _coefficients_of_kick_drift_words(kicks, drifts, order)
    for length in range(1, order + 1):
        failed = np.abs(result[length] - 1.0 / math.factorial(length)) > TOLERANCE
        if failed.any():
            index = int(np.argmax(failed))
            word = " ".join("KD"[index >> bit & 1] for bit in reversed(range(length)))
            return (
                f"order {length} needs 1/{math.factorial(length)} for the word {word} of kicks and "
                f"drifts, and these coefficients give {result[length][index]:.12g}"
            )
    return None


def failed_order_condition(tableau: Sequence[Sequence[float]], order: int) -> str | None:
    """Describe the first order condition that a Runge-Kutta tableau (s + 1, s) fails, or return None."""
    rows, weights = np.array(tableau[:-1]), np.array(tableau[-1])
    for nodes in range(1, order + 1):
        for tree in _rooted_trees(nodes):
            result = float(weights @ _elementary_stage_weights(tree, rows))
            if abs(result - 1.0 / _tree_density(tree)) > TOLERANCE:
                return (
                    f"order {nodes} needs 1/{_tree_density(tree)} for the tree {_tree_name(tree)}, "
                    f"and this tableau gives {result:.12g}"
                )
    return None


def _coefficients_of_kick_drift_words(
    kicks: Sequence[float], drifts: Sequence[float], order: int
) -> list[np.ndarray]:
    """Return the coefficients of all words by length; the bits of an index are kicks (0) and drifts (1)."""
    result = [np.zeros(1 << length) for length in range(order + 1)]
    result[0][0] = 1.0
    durations = itertools.chain.from_iterable(itertools.zip_longest(kicks, drifts, fillvalue=0.0))
    for k, duration in enumerate(durations):
        if duration != 0.0:
            result = _multiply_by_exponential(result, k % 2, duration)
    return result


def _multiply_by_exponential(result: list[np.ndarray], letter: int, duration: float) -> list[np.ndarray]:
    """Multiply from the right by exp(duration x letter); return the new coefficients of all words."""
    made = []
    for length in range(len(result)):
        total = np.zeros(1 << length)
        for more in range(length + 1):
            last = (1 << more) - 1 if letter else 0
            # All words that end with ``more`` letters of this kind: their bits end in as many zeros or ones.
            total[last :: 1 << more] += duration**more / math.factorial(more) * result[length - more]
        made.append(total)
    return made


@functools.cache
def _rooted_trees(nodes: int) -> tuple[Tree, ...]:
    """Return all rooted trees with a given number of nodes, without repetition."""
    return tuple(_multisets_of_trees(nodes - 1, nodes - 1))


def _multisets_of_trees(nodes: int, largest: int) -> Iterator[Tree]:
    """Return all multisets of trees with ``nodes`` nodes in total and at most ``largest`` in each tree."""
    if nodes == 0:
        yield ()
        return
    for size in range(min(nodes, largest), 0, -1):
        for count in range(nodes // size, 0, -1):
            for same in itertools.combinations_with_replacement(_rooted_trees(size), count):
                for rest in _multisets_of_trees(nodes - size * count, size - 1):
                    yield (*same, *rest)


def _node_count(tree: Tree) -> int:
    return 1 + sum(map(_node_count, tree))


def _tree_density(tree: Tree) -> int:
    return _node_count(tree) * math.prod(map(_tree_density, tree))


def _elementary_stage_weights(tree: Tree, rows: np.ndarray) -> np.ndarray:
    result = np.ones(len(rows))
    for child in tree:
        result = result * (rows @ _elementary_stage_weights(child, rows))
    return result


def _tree_name(tree: Tree) -> str:
    return "[" + "".join(map(_tree_name, tree)) + "]"


COMPENSATED = "+compensated"
"""Suffix of a method's name that requests compensated sums (Kahan) of positions and velocities."""

MAXIMUM_STAGES = 64
"""Maximum number of stages of a step; the longest published methods have about forty."""


@dataclasses.dataclass(frozen=True)
class Method:
    """An integration method, built in or user-defined.

    >>> from granular import Method
    >>> leapfrog = Method("my-leapfrog", 2, kicks=(0.5, 0.5), drifts=(1.0,))
    >>> leapfrog.order
    2

    Attributes
    ----------
    name : str
        Name, a single printable word.
    order : int
        Order of convergence, from 1 to 10. The coefficients are checked against the conditions of this order.
    source : str
        Paper with the coefficients.
    kicks, drifts : tuple of float
        For a composition: fractions of the step in the order kick b_0, drift a_1, kick b_1, ...,
        drift a_s, kick b_s, with s of 64 or less. Each fraction is from -1000 to 1000.
    tableau : tuple of tuple of float, or None
        For an explicit Runge-Kutta method: the s rows of its Butcher tableau, followed by the
        weights, s numbers each.
    variable : bool
        True for time-reversible variable steps, which are shorter when the highest frequency is higher;
        available only with Verlet's coefficients.
    compensated : bool
        True if positions and velocities are added with compensated sums (Kahan); not with a tableau.

    Raises
    ------
    InputError
        If a field or the table is malformed, or the table fails a condition of the declared order.
    """

    name: str
    order: int
    source: str = ""
    kicks: tuple[float, ...] = (0.0,)
    drifts: tuple[float, ...] = ()
    tableau: tuple[tuple[float, ...], ...] | None = None
    variable: bool = False
    compensated: bool = False

    def __post_init__(self) -> None:
        _check_name_and_order(self)
        if self.tableau is None:
            for name in ("kicks", "drifts"):
                object.__setattr__(self, name, _parse_step_fractions(self, name, getattr(self, name)))
            _check_composition(self)
            failed = failed_composition_condition(self.kicks, self.drifts, self.order)
        else:
            object.__setattr__(self, "tableau", _tableau_rows(self))
            _check_tableau(self)
            failed = failed_order_condition(self.tableau, self.order)
        if failed is not None:
            raise InputError(
                f"method {quote(self.name)} declares order {self.order}: {failed}; correct the coefficients "
                "or the order"
            )

    @property
    def symplectic(self) -> bool:
        """True for compositions with equal steps, which are symplectic without dissipation."""
        return self.tableau is None and not self.variable

    @property
    def literature(self) -> tuple[str, ...]:
        """Reference of the method: a tuple of one string, which may be empty; see `granular.cite`."""
        return (self.source,)

    @property
    def force_evaluations_per_step(self) -> int:
        """Number of force evaluations per step; the first kick reuses the last forces of the step before."""
        if self.tableau is not None:
            return len(self.tableau) - 1
        return sum(1 for kick in self.kicks[1:] if kick) or 1

    @property
    def has_backward_parts(self) -> bool:
        """True if a kick or drift has a negative duration, for which dry friction is undefined."""
        return min((*self.kicks, *self.drifts)) < 0.0

    @property
    def allows_far_field_impulses(self) -> bool:
        """True for Verlet's method, the only one that keeps its order if the far field acts in impulses."""
        return self.kicks == (0.5, 0.5) and not self.variable

    @property
    def allows_dry_friction(self) -> bool:
        """True for compositions with equal steps and without negative durations."""
        return self.tableau is None and not self.has_backward_parts and not self.variable

    def __str__(self) -> str:
        count = self.force_evaluations_per_step
        calls = f"{count} force evaluation{'s' * (count != 1)} per step"
        return ", ".join([f"order {self.order}", calls, *(["variable steps"] * self.variable), self.source])

    def to_plain(self) -> dict[str, Any]:
        """Return the method as plain data, which `resolve_method` reads.

        Returns
        -------
        dict
            ``name``, ``order``, ``source``, and ``kicks`` and ``drifts``, or ``tableau``, as lists;
            ``variable`` and ``compensated`` if they are True.
        """
        plain: dict[str, Any] = {"name": self.name, "order": self.order, "source": self.source}
        if self.tableau is None:
            plain |= {"kicks": list(self.kicks), "drifts": list(self.drifts)}
        else:
            plain |= {"tableau": [list(row) for row in self.tableau]}
        flags = {"variable": self.variable, "compensated": self.compensated}
        return plain | {name: True for name, value in flags.items() if value}


def method_from_plain(plain: Mapping[str, Any]) -> Method:
    """Make a method from plain data as returned by `Method.to_plain` or given in a study's file."""
    known = [field.name for field in dataclasses.fields(Method)]
    for name in plain:
        if name not in known:
            raise InputError(f"a method has no field {quote(name)}; choose from {', '.join(known)}")
    for name in ("name", "order"):
        if name not in plain:
            raise InputError(f"the method lacks the required field {name!r}; add it")
    return Method(**plain)


def _check_name_and_order(method: Method) -> None:
    if not isinstance(method.name, str) or not method.name or not method.name.isprintable():
        raise InputError(f"method name = {quote(method.name)} is not a printable word; give another name")
    if not isinstance(method.source, str):
        raise InputError(f"source = {quote(method.source)} of a method is not a string; put it in quotes")
    if type(method.order) is not int or not 1 <= method.order <= HIGHEST_ORDER:
        raise InputError(
            f"method {quote(method.name)}: order = {quote(method.order)} must be an integer "
            f"from 1 to {HIGHEST_ORDER}"
        )
    for name in ("variable", "compensated"):
        if type(getattr(method, name)) is not bool:
            raise InputError(f"{name} = {quote(getattr(method, name))} of a method must be True or False")


def _parse_step_fractions(method: Method, label: str, values: Any) -> tuple[float, ...]:
    """Convert the fractions of a step to floats; raise an error if they are not a short list of numbers."""
    words = f"{label} of method {quote(method.name)}"
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise InputError(f"{words} are {quote(values)}, which is not a list; give a list of numbers")
    result = tuple(values)
    if len(result) > MAXIMUM_STAGES + 1:
        raise InputError(f"{words} are {len(result)} numbers; give {MAXIMUM_STAGES + 1} or fewer")
    for value in result:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"{words} contain {quote(value)}, which is not a number; give numbers")
        # Published fractions are below 2; products of ten numbers of this size would exceed the conditions'
        # tolerance by rounding.
        if not math.isfinite(value) or abs(value) > 1e3:
            raise InputError(f"{words} contain {value:g}; give fractions of a step from -1000 to 1000")
    return tuple(map(float, result))


def _tableau_rows(method: Method) -> tuple[tuple[float, ...], ...]:
    rows = method.tableau
    if isinstance(rows, str) or not isinstance(rows, Iterable):
        raise InputError(
            f"tableau of method {quote(method.name)} is {quote(rows)}, not a list; give rows of numbers"
        )
    return tuple(_parse_step_fractions(method, f"tableau's row {k}", row) for k, row in enumerate(rows))


def _check_composition(method: Method) -> None:
    if len(method.kicks) != len(method.drifts) + 1 or not method.drifts:
        raise InputError(
            f"method {quote(method.name)} has {len(method.kicks)} kicks and {len(method.drifts)} "
            "drifts; give one kick more than drifts, with a kick of 0 if a step begins or ends with a drift"
        )
    if method.variable and (method.kicks, method.drifts) != ((0.5, 0.5), (1.0,)):
        raise InputError(
            f"method {quote(method.name)}: variable steps require kicks (0.5, 0.5) and drifts (1,); "
            "use these, or remove variable"
        )


def _check_tableau(method: Method) -> None:
    assert method.tableau is not None
    name, stages = quote(method.name), len(method.tableau) - 1
    if method.variable or method.compensated:
        raise InputError(
            f"method {name} is a Runge-Kutta method, which has neither variable steps nor compensated sums; "
            "remove variable and compensated"
        )
    if (method.kicks, method.drifts) != ((0.0,), ()):
        raise InputError(f"method {name} has a tableau and kicks or drifts; give one of them")
    if stages < 1 or any(len(row) != stages for row in method.tableau):
        raise InputError(f"tableau of method {name} must have s rows of s numbers, and s weights")
    for k, row in enumerate(method.tableau[:-1]):
        if any(row[k:]):
            raise InputError(
                f"tableau of method {name} is implicit in row {k}; put zeros on and right of the diagonal"
            )
