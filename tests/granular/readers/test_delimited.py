"""Which of the lines above the numbers is the header."""

from __future__ import annotations

from pathlib import Path

import pytest

from granular import PistonRecord


def read(path: Path, *head: str) -> PistonRecord:
    rows = [f"{0.01 * k:.2f},{55.0 + k % 3}" for k in range(20)]
    path.write_text("\n".join([*head, *rows, ""]), encoding="utf-8")
    return PistonRecord.from_file(path)


@pytest.mark.parametrize("line", ["Time,noon", "Elapsed time,12 min and more", "Date,noon"])
def test_a_line_about_time_above_the_header_is_none(line: str, tmp_path: Path) -> None:
    """The names and units directly above the numbers count."""
    for header in ("x [s],height [mm]", "t,height [mm]", "time [s],level [mm]"):
        record = read(tmp_path / "record.csv", line, header)
        assert record.height[0] == pytest.approx(0.055)


def test_what_was_done_to_a_column_stands_below_its_unit(tmp_path: Path) -> None:
    record = read(tmp_path / "record.csv", "TIMESTAMP,Piston height", "s,mm", "Smp,Avg")
    assert record.height[0] == pytest.approx(0.055)
