"""Which terms can be weighed along a motion."""

from __future__ import annotations

import numpy as np
import pytest

from granular import PistonRecord
from reduced_models.discovery.term_libraries import find_term_fault, library_terms
from reduced_models.discovery.weak_form import estimate_motion
from reduced_models.laws.law import HeightLine

TIME = np.linspace(0.0, 40.0, 1000)
SWING = PistonRecord(TIME, np.exp(-0.02 * TIME) * np.cos(TIME))


@pytest.mark.parametrize("library", ["contact", "trigonometric", "dry friction", "polynomial"])
def test_terms_that_are_zero_for_a_while_have_no_pole(library: str) -> None:
    """As those of a contact have on the other side of z = 0."""
    motion = estimate_motion(SWING, HeightLine())
    assert not [
        find_term_fault(motion, term)
        for term in library_terms(library, (), 3, None)
        if find_term_fault(motion, term)
    ]


def test_a_power_below_zero_has_one() -> None:
    motion = estimate_motion(SWING, HeightLine())
    faults = {one.text: find_term_fault(motion, one) for one in library_terms((), ["1/z", "z'/z"], 3, None)}
    assert set(faults.values()) == {"has a pole"}
