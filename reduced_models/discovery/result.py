"""The result of a discovery, the same for every method."""

from __future__ import annotations

import dataclasses
import functools
import math
import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from granular.shared.errors import InputError
from reduced_models.discovery.terms import (
    AnyTerm,
    ScaledHiddenState,
    expression_text,
    round_fractions_for_print,
    terms_with_coefficients,
)
from reduced_models.laws.law import HeightLine
from reduced_models.models.model import ReducedModel
from reduced_models.models.quantities import caution_lines, wrap_words

if TYPE_CHECKING:
    import sympy


_NEIGHBOURS = 4
"""Number of candidates shown on either side of the chosen one."""
_EQUATION_COLUMNS = 82
"""Width in characters of equations that were not chosen."""


@dataclasses.dataclass(frozen=True, eq=False)
class CandidateEquation:
    """An equation on the Pareto front."""

    expression: sympy.Expr
    complexity: int
    error: float
    criterion: float
    models: tuple[ReducedModel, ...] = ()
    note: str = ""
    hidden_state: ScaledHiddenState | None = None
    left_side: str = "z''"

    @property
    def model(self) -> ReducedModel | None:
        """Model fitted to the first record, a ReducedModel; None if the candidate was not fitted."""
        return self.models[0] if self.models else None

    @functools.cached_property
    def terms(self) -> Mapping[AnyTerm, float] | None:
        """Terms of the equation with their coefficients; None if the equation is not a sum of terms."""
        return terms_with_coefficients(self.expression)  # cached: it takes milliseconds per term

    @property
    def text(self) -> str:
        """Text of the equation, such as "z'' = -39.5*z - 0.2*z'", with numbers to five digits."""
        import sympy

        numbers = {atom: sympy.Float(atom, 5) for atom in self.expression.atoms(sympy.Float)}
        right = expression_text(round_fractions_for_print(self.expression.xreplace(numbers)))
        text = f"{self.left_side} = {right}"
        return text if self.hidden_state is None else self.hidden_state.substitute_into(text)


@dataclasses.dataclass(frozen=True, eq=False)
class Discovery:
    """Equations discovered in one record or several.

    Attributes
    ----------
    method : str
    candidates : tuple of CandidateEquation
        Equations on the Pareto front and close competitors that were fitted, the simplest first.
    chosen : int
        Index of the chosen candidate.
    line : HeightLine
        Height as a function of the equations' z: shift and scale [m].
    notes : tuple of str
        Cautions in plain words.
    criterion_increases : mapping of str to float
        For each term of the chosen sum, rise of the information criterion if the term is removed; a
        rise above about 10 is decisive evidence for the term. Empty if the chosen equation is not a sum
        of terms.
    """

    method: str
    candidates: tuple[CandidateEquation, ...]
    chosen: int
    line: HeightLine
    notes: tuple[str, ...] = ()
    criterion_increases: Mapping[str, float] = dataclasses.field(default_factory=dict)

    @property
    def best(self) -> CandidateEquation:
        """The chosen candidate."""
        return self.candidates[self.chosen]

    @property
    def expression(self) -> sympy.Expr:
        """Right side of the chosen equation, a sympy.Expr in z, v (for z'), u (for the input) and t."""
        return self.best.expression

    @property
    def model(self) -> ReducedModel:
        """Model of the chosen candidate for the first record, fitted through its differential equation."""
        if self.best.model is None:
            why = self.best.note or "it was not fitted to the record"
            raise InputError(
                f"the discovered equation {self.best.text} has no model: {why}; see .candidates "
                "for the other equations"
            )
        return self.best.model

    def __str__(self) -> str:
        model = self.best.model
        printed_notes = () if model is None else model.notes
        lines = wrap_words(f"model: {self.best.text}; {self.line.text}", "")
        if model is not None:
            lines = str(model).splitlines()
        lines.append(
            f"candidates by {self.method} (complexity, error relative to the record's noise; * is chosen):"
        )
        first, last = max(0, self.chosen - _NEIGHBOURS), self.chosen + _NEIGHBOURS + 1
        for k, candidate in enumerate(self.candidates[first:last], start=first):
            mark = "*" if k == self.chosen else " "
            text = candidate.text
            if k != self.chosen:
                text = textwrap.shorten(text, _EQUATION_COLUMNS, placeholder=" ...")
            lines.append(f" {mark} {candidate.complexity:3d}  {candidate.error:9.4g}  {text}")
        if hidden_count := len(self.candidates) - len(self.candidates[first:last]):
            lines.append(f"   and {hidden_count} more, listed by .candidates and --json")
        increases = ", ".join(f"{name}: {rise:.3g}" for name, rise in self.criterion_increases.items())
        if increases:
            words = "rise of the extended Bayesian information criterion without each term"
            lines += wrap_words(f"{words} (10 is decisive): {increases}")
        return "\n".join([*lines, *caution_lines([note for note in self.notes if note not in printed_notes])])

    def to_plain(self) -> dict[str, Any]:
        """Return the discovery as plain data (numbers, texts, lists)."""
        return {
            "method": self.method,
            "chosen": self.chosen,
            "height": self.line._asdict(),
            "notes": list(self.notes),
            "prices": dict(self.criterion_increases),
            "candidates": [
                {
                    "equation": candidate.text,
                    "expression": str(candidate.expression),
                    "complexity": candidate.complexity,
                    "error": candidate.error,
                    "criterion": candidate.criterion,
                    "model": None if candidate.model is None else candidate.model.to_plain(),
                    "note": candidate.note,
                }
                for candidate in self.candidates
            ],
        }


def pareto_front(candidates: list[CandidateEquation]) -> list[CandidateEquation]:
    """Return the candidates with a smaller error than every simpler candidate, the simplest first."""
    front: list[CandidateEquation] = []
    order = sorted(candidates, key=lambda candidate: (candidate.complexity, candidate.error))
    for candidate in order:
        if math.isfinite(candidate.error) and (not front or candidate.error < front[-1].error):
            front.append(candidate)
    return front
