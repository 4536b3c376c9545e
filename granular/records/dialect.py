"""Dialect of the lines of a table in text: separator, decimal sign, columns."""

from __future__ import annotations

import collections
import contextlib
import csv
import re
from collections.abc import Sequence
from typing import NamedTuple

from granular.records.sheet import LOST, is_number, is_timestamp

SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}
_LOOKED_AT = 200
"""Lines at the beginning, in the middle and at the end that are inspected."""
_ENOUGH, _FEWEST = 2**20, 12
"""Characters after which no further lines are inspected, and the least number of lines."""


class NumberedLine(NamedTuple):
    """A line of a file: its number, from 1, and its text."""

    number: int
    text: str


class Dialect(NamedTuple):
    """Dialect in which the lines of a table are written."""

    separator: str
    decimal: str
    width: int
    numeric: tuple[int, ...]


def detect_dialect(
    lines: Sequence[NumberedLine], decimal: str | None, least_numbers: int = 2
) -> Dialect | None:
    """Detect the dialect in which most lines are rows of numbers."""
    sample = [line.text for line in lines_to_inspect(lines)]
    tried = [
        _try_dialect(sample, separator, mark, least_numbers)
        for separator in SEPARATORS
        for mark in ((".", ",") if decimal is None else (decimal,))
    ]
    best = max(filter(None, tried), key=lambda item: item[0], default=None)
    return None if best is None else best[1]


def lines_to_inspect(lines: Sequence[NumberedLine]) -> list[NumberedLine]:
    """Return lines of the beginning, the middle and the end; fewer if lines are very long."""
    middle = len(lines) // 2
    numbers = (number for k in range(_LOOKED_AT) for number in (k, middle + k, len(lines) - 1 - k))
    sampled: set[int] = set()
    characters = 0
    for number in numbers:
        if 0 <= number < len(lines) and number not in sampled:
            characters += len(lines[number].text)
            if characters > _ENOUGH and len(sampled) >= _FEWEST:
                break
            sampled.add(number)
    return [lines[k] for k in sorted(sampled)]


def _try_dialect(
    sample: Sequence[str], separator: str, decimal: str, least_numbers: int
) -> tuple[tuple[int, float, int], Dialect] | None:
    """Count the lines that a dialect explains, the fraction of numbers in them, and columns."""
    rows = [split_fields(line, separator) for line in sample]
    if decimal == "," and any(
        "." in cell and is_number(cell, ".") and not is_timestamp(cell) for row in rows for cell in row
    ):
        return None
    numeric = [{k for k, cell in enumerate(row) if is_number(cell, decimal)} for row in rows]
    widths = collections.Counter(
        len(row) for row, good in zip(rows, numeric, strict=True) if len(good) >= least_numbers
    )
    if not widths:
        return None
    raw = max(widths, key=lambda width: (widths[width], width))
    same = [k for k, row in enumerate(rows) if len(row) == raw and numeric[k]]
    width = raw  # without what stands behind a separator at the end of all lines: nothing
    while not any(rows[k][width - 1] for k in same):
        width -= 1
    numbers = collections.Counter(field for k in same for field in numeric[k])
    lost = collections.Counter(field for k in same for field, cell in enumerate(rows[k]) if cell in LOST)
    core = tuple(field for field in sorted(numbers) if numbers[field] + lost[field] >= 0.5 * len(same))
    if len(core) < least_numbers:
        return None
    fraction = (sum(numbers.values()) + sum(lost.values())) / (len(same) * raw)
    return (widths[raw], fraction, len(core)), Dialect(separator, decimal, width, core)


_WITH_COMMA = re.compile(r"\s*[+-]?(\d+),\d+", re.ASCII)
_COMMA = re.compile(r"(\d),(\d+)", re.ASCII)


def has_decimal_commas(lines: Sequence[NumberedLine], dialect: Dialect, decimal: str | None) -> bool | None:
    """Tell rows in which every second comma is a decimal one."""
    rows = [line.text.strip().split(",") for line in lines_to_inspect(lines)]
    pairs = [_WITH_COMMA.fullmatch(",".join(row[k : k + 2])) for row in rows for k in range(0, len(row), 2)]
    if decimal == "." or dialect.width < 4 or not all(pairs):
        return False
    if decimal == ",":
        return True
    # Decimals may begin with a zero, integers do not; and decimals are as many in each line, or end with no
    # zero.
    behind = [[row[k] for row in rows] for k in range(1, dialect.width, 2)]
    digits = [cell for column in behind for cell in column]
    as_many = all(len(set(map(len, column))) == 1 for column in behind)
    if not (as_many or not any(cell.endswith("0") for cell in digits)):
        return False
    integers = [match[1] for match in pairs if match is not None]
    return (any(map(_is_zero_padded, digits)) and not any(map(_is_zero_padded, integers))) or None


def _is_zero_padded(digits: str) -> bool:
    return len(digits) > 1 and digits[0] == "0"


def replace_decimal_commas(lines: Sequence[NumberedLine]) -> list[NumberedLine]:
    """Replace the first comma of each line, and every second one after it, by a point."""
    return [NumberedLine(line.number, _COMMA.sub(r"\1.\2", line.text)) for line in lines]


def split_fields(line: str, separator: str) -> list[str]:
    """Split a line into its fields, without the spaces around them."""
    if separator == " ":
        return line.split()
    cells = line.split(separator)
    if '"' in line:
        # not a cell of more than 131072 characters, which is no number either
        with contextlib.suppress(csv.Error):
            cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True)) or cells
    return [cell.strip() for cell in cells]


_WORD = re.compile(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?|[\[(][^\])]*[\])]")


def split_header(line: str, separator: str) -> list[str]:
    """Split a header into its fields; between spaces, a unit in brackets belongs to its name."""
    return _WORD.findall(line) if separator == " " else split_fields(line, separator)


def is_table_row(fields: Sequence[str], dialect: Dialect) -> bool:
    """Tell a line of the table: as many fields, of which some are numbers."""
    return len(trim_fields(fields, dialect.width)) == dialect.width and any(
        is_number(fields[k], dialect.decimal) for k in dialect.numeric
    )


def trim_fields(fields: Sequence[str], width: int) -> Sequence[str]:
    """Drop the empty fields beyond the width of a table."""
    end = len(fields)
    while end > width and not fields[end - 1]:
        end -= 1
    return fields[:end]
