"""Runs and fits agree with the digests and values stored in tests/data/digests.json."""

import json
import warnings

import pytest

from reduced_models.laws import LAWS
from tests.regression.digests import FILE, cases, fit_of, run_of, surroundings

STORED = json.loads(FILE.read_text(encoding="utf-8"))
QUICK = {("bed", "direct", 1), ("damper", "direct", 1)}  # compiled by other tests anyway
ROUGH_RUN, ROUGH_FIT = 1e-6, 1e-4
"""Relative tolerance with another processor or other libraries: to the printed digits for fits."""


def long_unless(quick: bool, *values: object) -> object:
    return pytest.param(*values, marks=() if quick else pytest.mark.long)


def same_surroundings() -> bool:
    """Return True if the last digits can be compared; otherwise warn of the differences."""
    here, there = surroundings(), STORED["surroundings"]
    others = [f"{key} {here[key]}, not {there[key]}" for key in here if here[key] != there[key]]
    if others:
        warnings.warn(f"digests are of other surroundings: {'; '.join(others)}", stacklevel=2)
    return not others


@pytest.mark.parametrize(
    ("name", "way", "threads"),
    [long_unless((*case, threads) in QUICK, *case, threads) for case in cases() for threads in (1, 2)],
)
def test_runs_are_bit_identical_to_stored_digests(name: str, way: str, threads: int) -> None:
    """The number of threads does not matter.

    With another processor or library, rms values agree to six digits.
    """
    stored = STORED["runs"][f"{name}, {way}"]
    found = run_of(name, way, threads)
    assert found.keys() == stored.keys()
    if same_surroundings():
        assert found == stored
    for quantity, values in found.items():
        assert values["rms"] == pytest.approx(stored[quantity]["rms"], rel=ROUGH_RUN)


@pytest.mark.parametrize("law", [long_unless(law == "linear", law) for law in LAWS])
def test_fits_agree_with_stored_values(law: str) -> None:
    """They agree to 1e-9, or to the printed digits on another processor or with other libraries."""
    stored, found = STORED["fits"][law], fit_of(law)
    near = 1e-9 if same_surroundings() else ROUGH_FIT
    assert found.keys() == stored.keys()
    for parameter, values in found.items():
        assert values == pytest.approx(stored[parameter], rel=near)


def test_stored_digests_include_every_run_and_fit() -> None:
    assert set(STORED["runs"]) == {f"{name}, {way}" for name, way in cases()}
    assert set(STORED["fits"]) == set(LAWS)
