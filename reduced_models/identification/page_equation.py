"""The equations of a fitted law in a report."""

from __future__ import annotations

from granular.shared.html import Page, number
from reduced_models.laws.printing import mathml, mathml_of_rate, rounded_expression
from reduced_models.models.model import ReducedModel


def add_equations(page: Page, model: ReducedModel) -> None:
    """The law with symbols and with its numbers, and those of its hidden states."""
    symbols = {
        name: rounded_expression(rate, model.printed_digits)
        for name, rate in model.law.sympy_hidden().items()
    }
    for equation, rates in (
        (model.equation, symbols), (model.printed_equation, model.printed_hidden),
    ):  # fmt: skip
        page.equation(mathml(equation))
        for name, rate in rates.items():
            page.equation(mathml_of_rate(name, rate))
    if model.law.hidden:
        starts = (f"{name} = {number(model.hidden.get(name, 0.0), 3)}" for name in model.law.hidden)
        page.text(f"At the start {', '.join(starts)}.")
