"""The tables behind the pictures, which few will read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from granular.shared.html import Page
from validation.convergence_result import ConvergenceResult, convergence_table
from validation.outcomes import Outcome
from validation.parts import Plain
from validation.sections.common import sound, tabulate
from validation.sections.cost import studies
from validation.sections.stability import case_table, stability_table


def measurements(page: Page, results: Mapping[str, Sequence[Plain]]) -> None:
    """The tables behind the pictures, which few will read."""
    page.section("All measurements")
    if ones := sound(results.get("convergence", ())):
        page.text("Orders of convergence.")
        tabulate(page, convergence_table([ConvergenceResult.from_plain(one) for one in ones]))
    for one in studies(sound(results.get("work-precision", ()))):
        page.text(f"Cost of the {one.quantity} of {one.scene}; a star marks the best of all.")
        tabulate(page, one.table())
    if ones := sound(results.get("stability", ())):
        found = [Outcome.from_plain(one) for one in ones]
        page.text("Hard cases.")
        tabulate(page, stability_table(found))
        page.text("What is hard, and what is measured.")
        tabulate(page, case_table({one.case for one in found}))
