"""The print-out of a discovery."""

from __future__ import annotations

import sympy

from reduced_models.discovery.result import CandidateEquation, Discovery
from reduced_models.laws.law import HeightLine


def test_a_long_front_is_printed_on_one_screen() -> None:
    """The chosen equation is never cut, nor counted among those left out."""
    z = sympy.Symbol("z", real=True)
    front = [
        CandidateEquation(sum(1.5 * z**power for power in range(1, terms + 1)), terms, 1.0, 0.0)
        for terms in range(1, 30)
    ]
    lines = str(Discovery("sindy", tuple(front), 20, HeightLine())).splitlines()
    (chosen,) = (line for line in lines if line.startswith(" * "))
    assert chosen.endswith(front[20].text)
    assert len(lines) <= 20
    assert max(len(line) for line in lines if line != chosen) <= 100
    assert any(line.startswith("   and 20 more") for line in lines)
