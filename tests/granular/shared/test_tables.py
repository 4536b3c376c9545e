"""Texts as LaTeX."""

from __future__ import annotations

from granular.shared.blocks import Table
from granular.shared.terminal import latex_array


def test_signs_of_latex_are_letters() -> None:
    found = latex_array(Table(["law", "C:\\"], [["a_1 & 50 %", "{x}^2"]]))
    assert r"\text{a\_1 \& 50 \%} & \text{\{x\}\^{}2} \\" in found
    assert r"\text{law} & \text{C:\textbackslash{}} \\ \hline" in found
    assert found.startswith("$$\\begin{array}{ll}\n")
