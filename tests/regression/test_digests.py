"""Runs have the bits, and fits the figures, that tests/data/digests.json holds."""

import json
import warnings

import pytest

from reduced_models.laws import LAWS
from tests.regression.digests import FILE, cases, fit_of, run_of, surroundings

STORED = json.loads(FILE.read_text(encoding="utf-8"))
QUICK = {("bed", "direct", 1), ("damper", "direct", 1)}  # compiled by other tests anyway
ROUGH_RUN, ROUGH_FIT = 1e-6, 1e-4
"""Agreement of figures where processor or libraries are others, relative: fits as printed."""


def long_unless(quick: bool, *values: object) -> object:
    return pytest.param(*values, marks=() if quick else pytest.mark.long)


def same_surroundings() -> bool:
    """Whether the last digits can be compared; says what is different where they cannot."""
    here, there = surroundings(), STORED["surroundings"]
    others = [f"{key} {here[key]}, not {there[key]}" for key in here if here[key] != there[key]]
    if others:
        warnings.warn(f"digests are of other surroundings: {'; '.join(others)}", stacklevel=2)
    return not others


@pytest.mark.parametrize(
    ("name", "way", "threads"),
    [long_unless((*case, threads) in QUICK, *case, threads) for case in cases() for threads in (1, 2)],
)
def test_runs_keep_their_bits(name: str, way: str, threads: int) -> None:
    """For any number of threads; where processor or libraries are others, to six digits."""
    stored = STORED["runs"][f"{name}, {way}"]
    found = run_of(name, way, threads)
    assert found.keys() == stored.keys()
    if same_surroundings():
        assert found == stored
    for quantity, values in found.items():
        assert values["rms"] == pytest.approx(stored[quantity]["rms"], rel=ROUGH_RUN)


@pytest.mark.parametrize("law", [long_unless(law == "linear", law) for law in LAWS])
def test_fits_keep_their_figures(law: str) -> None:
    """Parameters and intervals, to 1e-9; where processor or libraries are others, as printed."""
    stored, found = STORED["fits"][law], fit_of(law)
    near = 1e-9 if same_surroundings() else ROUGH_FIT
    assert found.keys() == stored.keys()
    for parameter, values in found.items():
        assert values == pytest.approx(stored[parameter], rel=near)


def test_every_case_is_stored() -> None:
    assert set(STORED["runs"]) == {f"{name}, {way}" for name, way in cases()}
    assert set(STORED["fits"]) == set(LAWS)
