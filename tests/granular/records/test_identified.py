"""From a file as an instrument wrote it to engineers' figures, without an option."""

import math
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from .forms import FORMS

FILES = (
    "excel_german",
    "excel_unicode",
    "savetxt",
    "campbell",
    "phyphox",
    "labview",
    "tdms",
    "excel",
    "matlab",
    "logger_pro",
)
OMEGA = math.hypot(21.0, 0.8)
"""Of the motion in all files [rad/s]: it swings at 21 and decays at 0.8 1/s."""
TRUTH = {
    "level of rest": (59.0, "mm"),
    "natural frequency": (OMEGA / (2.0 * math.pi), "Hz"),
    "damping ratio": (100.0 * 0.8 / OMEGA, "%"),
}


def test_there_are_ten() -> None:
    assert len(FILES) == 10
    assert not any(FORMS[name].said for name in FILES)


@pytest.mark.long
@pytest.mark.parametrize("name", FILES)
def test_the_truth_is_in_the_printed_intervals(name: str, command: Callable, tmp_path: Path) -> None:
    path = tmp_path / FORMS[name].name
    FORMS[name].write(path)
    done = command("reduced_models", "identify", str(path), "-o", str(tmp_path / "out"), "--quiet")
    assert done.returncode == 0, done.stderr
    for quantity, (true, unit) in TRUTH.items():
        row = rf"{quantity}: (\S+) {unit}  \[(\S+) to (\S+)\]"
        found = re.search(row, done.stdout)
        assert found is not None, quantity
        value, low, high = map(float, found.groups())
        assert low <= value <= high
        assert low <= true <= high, (quantity, found[0], true)
    assert (tmp_path / "out" / "report.html").is_file()
