"""Tables in text: CSV and similar, with preambles, unit rows, decimal commas and missing samples."""

from __future__ import annotations

import collections
import contextlib
import csv
import functools
import io
import itertools
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from granular.records.headings import (
    TIME,
    guess_column_role,
    is_unit,
    name_and_unit,
    split_header_into_name_and_unit,
)
from granular.records.sheet import (
    MISSING,
    Column,
    Sheet,
    column_of_texts,
    is_number_or_timestamp,
    is_timestamp,
    parse_number,
)
from granular.shared.errors import RecordError, quote, sanitize

SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}
_INSPECTED_LINES = 200
"""Number of lines inspected at the beginning, in the middle and at the end."""
_MAX_INSPECTED_CHARACTERS, _MIN_INSPECTED_LINES = 2**20, 12


class NumberedLine(NamedTuple):
    """A line of a file: its number (from 1) and its text."""

    number: int
    text: str


class Dialect(NamedTuple):
    """Separator, decimal mark, number of fields and indices of numeric fields of a table."""

    separator: str
    decimal: str
    width: int
    numeric: tuple[int, ...]


def detect_dialect(
    lines: Sequence[NumberedLine], decimal: str | None, min_numbers: int = 2
) -> Dialect | None:
    """Detect the dialect in which most lines are rows of numbers."""
    sample = [line.text for line in lines_to_inspect(lines)]
    tried = [
        _score_and_complete_dialect(sample, separator, mark, min_numbers)
        for separator in SEPARATORS
        for mark in ((".", ",") if decimal is None else (decimal,))
    ]
    best = max(filter(None, tried), key=lambda item: item[0], default=None)
    return None if best is None else best[1]


def lines_to_inspect(lines: Sequence[NumberedLine]) -> list[NumberedLine]:
    """Select lines from the beginning, the middle and the end; fewer if lines are very long."""
    middle = len(lines) // 2
    numbers = (number for k in range(_INSPECTED_LINES) for number in (k, middle + k, len(lines) - 1 - k))
    sampled: set[int] = set()
    characters = 0
    for number in numbers:
        if 0 <= number < len(lines) and number not in sampled:
            characters += len(lines[number].text)
            if characters > _MAX_INSPECTED_CHARACTERS and len(sampled) >= _MIN_INSPECTED_LINES:
                break
            sampled.add(number)
    return [lines[k] for k in sorted(sampled)]


def _score_and_complete_dialect(
    sample: Sequence[str], separator: str, decimal: str, min_numbers: int
) -> tuple[tuple[int, float, int], Dialect] | None:
    """Return the score of a dialect (matching rows, their fraction of numbers, columns) and the dialect."""
    rows = [split_fields(line, separator) for line in sample]
    if decimal == "," and any(
        "." in cell and is_number_or_timestamp(cell, ".") and not is_timestamp(cell)
        for row in rows
        for cell in row
    ):
        return None
    numeric = [{k for k, cell in enumerate(row) if is_number_or_timestamp(cell, decimal)} for row in rows]
    widths = collections.Counter(
        len(row)
        for row, numeric_fields in zip(rows, numeric, strict=True)
        if len(numeric_fields) >= min_numbers
    )
    if not widths:
        return None
    raw = max(widths, key=lambda width: (widths[width], width))
    same = [k for k, row in enumerate(rows) if len(row) == raw and numeric[k]]
    width = raw  # less the empty fields after a separator at the end of all lines
    while not any(rows[k][width - 1] for k in same):
        width -= 1
    numbers = collections.Counter(field for k in same for field in numeric[k])
    lost = collections.Counter(field for k in same for field, cell in enumerate(rows[k]) if cell in MISSING)
    core = tuple(field for field in sorted(numbers) if numbers[field] + lost[field] >= 0.5 * len(same))
    if len(core) < min_numbers:
        return None
    fraction = (sum(numbers.values()) + sum(lost.values())) / (len(same) * raw)
    return (widths[raw], fraction, len(core)), Dialect(separator, decimal, width, core)


_DECIMAL_COMMA_PAIR = re.compile(r"\s*[+-]?(\d+),\d+", re.ASCII)
_COMMA = re.compile(r"(\d),(\d+)", re.ASCII)


def has_decimal_commas(lines: Sequence[NumberedLine], dialect: Dialect, decimal: str | None) -> bool | None:
    """Return True if every second comma is a decimal comma, False if not, None if that is ambiguous."""
    rows = [line.text.strip().split(",") for line in lines_to_inspect(lines)]
    pairs = [
        _DECIMAL_COMMA_PAIR.fullmatch(",".join(row[k : k + 2])) for row in rows for k in range(0, len(row), 2)
    ]
    if decimal == "." or dialect.width < 4 or not all(pairs):
        return False
    if decimal == ",":
        return True
    # Decimals may begin with a zero, integers do not. The number of decimals is the same in each line, or
    # decimals do not end with a zero.
    decimals = [[row[k] for row in rows] for k in range(1, dialect.width, 2)]
    digits = [cell for column in decimals for cell in column]
    equal_counts = all(len(set(map(len, column))) == 1 for column in decimals)
    if not (equal_counts or not any(cell.endswith("0") for cell in digits)):
        return False
    integers = [match[1] for match in pairs if match is not None]
    return (any(map(_is_zero_padded, digits)) and not any(map(_is_zero_padded, integers))) or None


def _is_zero_padded(digits: str) -> bool:
    return len(digits) > 1 and digits[0] == "0"


def replace_decimal_commas(lines: Sequence[NumberedLine]) -> list[NumberedLine]:
    """Replace the first, third, fifth ... comma of each line by a point."""
    return [NumberedLine(line.number, _COMMA.sub(r"\1.\2", line.text)) for line in lines]


def split_fields(line: str, separator: str) -> list[str]:
    """Split a line into fields without surrounding spaces."""
    if separator == " ":
        return line.split()
    cells = line.split(separator)
    if '"' in line:
        # fails for a cell of more than 131072 characters, which is not a number anyway
        with contextlib.suppress(csv.Error):
            cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True)) or cells
    return [cell.strip() for cell in cells]


_WORD = re.compile(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?|[\[(][^\])]*[\])]")


def split_header(line: str, separator: str) -> list[str]:
    """Split a header into fields; if spaces separate them, a unit in brackets stays with its name."""
    return _WORD.findall(line) if separator == " " else split_fields(line, separator)


def is_table_row(fields: Sequence[str], dialect: Dialect) -> bool:
    """Return True for a row of the table: it has the right number of fields, one of which is a number."""
    return len(trim_fields(fields, dialect.width)) == dialect.width and any(
        is_number_or_timestamp(fields[k], dialect.decimal) for k in dialect.numeric
    )


def trim_fields(fields: Sequence[str], width: int) -> Sequence[str]:
    """Drop the empty fields beyond the width of a table."""
    end = len(fields)
    while end > width and not fields[end - 1]:
        end -= 1
    return fields[:end]


_COMMENTS = "#%!"
"""Characters that begin a comment."""
_JSON = re.compile(r'\s*(?:\{\s*"|\[\s*[\[{"\d-])')
"""Beginning of a JSON file."""
_MAX_COLUMNS = 50_000
_BEGINS_WITH_QUANTITY = re.compile(r'\s*"?[+-]?[.,]?\d')
_BEGINS_WITH_NUMBER = re.compile(r"\s*[+-]?\d")
_NUMBER_WITH_UNIT = re.compile(
    r"(?<![\w.])([+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?)\s?([^\W\d_][^\s,;|\"]*|[°%][^\s,;|\"]*)"
    r"(?=\s*[,;|\"]|\s*$|\s+[+-]?[.,]?\d)"
)
"""A number followed by a unit, at the end of a cell."""
_is_known_unit = functools.lru_cache(maxsize=1024)(is_unit)  # called for each cell of a file
_MAX_ROW_CHARACTERS = 10_000
"""Maximum length of a row whose cells are searched for units."""
_MAX_NUMERIC_PREAMBLE = 50
"""Maximum number of lines in a preamble that begin with a number."""
_HEADER_SEPARATORS = (r"\t+", r"\s{2,}", ";", ",", r"\|")
"""Separators of a header that differ from the separator of the rows."""
_NAME_AND_UNIT = re.compile(r"[^\[\](){}]+[\[({][^\[\](){}]*[\])}]")
"""A name of several words, followed by a unit, as in ``Elapsed Time (s) Stage Position (mm)``."""
_HEADER_LINES = 4
"""Number of lines above the rows in which names and units are looked for."""


def read_delimited(text: str, decimal: str | None = None, skip: int = 0, min_columns: int = 2) -> Sheet:
    """Read the table in a text: CSV or similar, with preambles, unit rows and decimal commas."""
    lines = [
        NumberedLine(number, line)
        for number, line in enumerate(re.split(r"\r\n|\r|\n", text)[skip:], start=skip + 1)
        if line.strip()
    ]
    if lines and lines[0].text.lstrip()[0] in "{[" and _JSON.match(text):
        raise RecordError(
            "is JSON, which is not supported; write it as CSV, with pandas: "
            "pandas.read_json(FILE).to_csv('record.csv')"
        )
    _refuse_too_many_columns(lines)
    plain = [line for line in lines if line.text.lstrip()[0] not in _COMMENTS]
    if not plain:
        raise RecordError("is empty; write a header and samples to it")
    plain, row_with_units = _strip_units_and_keep_one_row(plain)
    dialect = detect_dialect(plain, decimal, min_columns)
    if dialect is None:
        single = detect_dialect(plain, decimal, 1)
        raise RecordError(_no_table_text(plain, one_column=single is not None and single.width == 1))
    start = _find_first_row_index(plain, dialect)
    head, below = plain[:start], plain[start:]
    _check_lines_above_table(head, dialect)
    names, units = _read_header_names_and_units(head, dialect, lines, below[0].number)
    commas = dialect.decimal == ","
    if dialect.separator == "," and not names and _has_decimal_commas(below, dialect, decimal):
        below, commas = replace_decimal_commas(below), True
        dialect = detect_dialect(below, ".", min_columns) or dialect
    rows, notes = _table_lines_and_notes_without_trailing_text(below, dialect)
    if row_with_units:
        in_cells = _units_after_numbers(row_with_units, dialect.separator)
        units = [here or above for here, above in itertools.zip_longest(in_cells, units, fillvalue="")]
    columns = _make_columns(rows, dialect, names, units, notes)
    words = f"text separated by {SEPARATORS[dialect.separator]}" + ", decimal commas" * commas
    return Sheet(columns, np.array([line.number for line in rows]), bool(names), words, notes)


def _strip_units_and_keep_one_row(lines: list[NumberedLine]) -> tuple[list[NumberedLine], str]:
    """Remove units after numbers, as in ``31.0 cm``; return the rows, and the text of one row with its units.

    If half of the rows or fewer have such units, the rows are unchanged and the text is empty.
    """
    sample = [line.text for line in lines_to_inspect(lines) if _BEGINS_WITH_QUANTITY.match(line.text)]
    if max(map(len, sample), default=0) > _MAX_ROW_CHARACTERS:
        return lines, ""
    examples = {
        tuple(match[2] for match in _matches_of_numbers_with_unit(text)): text for text in reversed(sample)
    }
    occurrences = collections.Counter(
        tuple(match[2] for match in _matches_of_numbers_with_unit(text)) for text in sample
    )
    del occurrences[()]
    if 2 * occurrences.total() <= len(sample):
        return lines, ""
    units = max(occurrences, key=occurrences.__getitem__)
    stripped = []
    for line in lines:
        matches = _matches_of_numbers_with_unit(line.text) if _BEGINS_WITH_QUANTITY.match(line.text) else []
        other_units = {match[2] for match in matches} - set(units)
        if other_units and len(matches) == len(units):
            raise RecordError(
                f"line {line.number} holds a number in {quote(other_units.pop())}, but the numbers of other "
                f"lines are in {' and '.join(map(quote, units))}; write each column in one unit"
            )
        stripped.append(NumberedLine(line.number, _remove_group_of_matches(line.text, matches, 2)))
    return stripped, examples[units]


def _units_after_numbers(row: str, separator: str) -> list[str]:
    """Return the unit after the number in each field of a row; empty for fields without a unit."""
    if separator == " ":
        fields = split_fields(_remove_group_of_matches(row, _matches_of_numbers_with_unit(row), 1), separator)
        return [field if is_unit(field) else "" for field in fields]
    return [
        next((match[2] for match in _matches_of_numbers_with_unit(field)), "")
        for field in split_fields(row, separator)
    ]


def _matches_of_numbers_with_unit(text: str) -> list[re.Match[str]]:
    """Find the numbers of a row that are followed by a unit."""
    return [match for match in _NUMBER_WITH_UNIT.finditer(text) if _is_known_unit(match[2])]


def _remove_group_of_matches(text: str, matches: Sequence[re.Match[str]], group: int) -> str:
    """Remove one group of each match from a text."""
    for match in reversed(matches):
        text = text[: match.start(group)] + text[match.end(group) :]
    return text


def _refuse_too_many_columns(lines: Sequence[NumberedLine]) -> None:
    for line in lines:
        long = len(line.text) > 2 * _MAX_COLUMNS
        width = 1 + max(map(line.text.count, SEPARATORS)) if long else 1
        if width > _MAX_COLUMNS:
            raise RecordError(
                f"line {line.number} has {width} values; the limit is {_MAX_COLUMNS} columns: write one "
                "sample per line, with fewer columns"
            )


def _no_table_text(lines: Sequence[NumberedLine], *, one_column: bool) -> str:
    """Write the error text for a file in which no line is a row of numbers."""
    if one_column:
        return (
            "is not separated by commas, semicolons, tabs or spaces: it holds one column of numbers; "
            "give the sampling rate (--rate '100 Hz'), or a time and a coordinate"
        )
    head = lines[0].text
    separator = max(SEPARATORS, key=lambda mark: len(split_fields(head, mark)))
    names = split_fields(head, separator)
    for line in lines[1:2]:
        cells = split_fields(line.text, separator)
        for name, cell in zip(names, cells, strict=False):
            if 1 < len(names) == len(cells) and not is_number_or_timestamp(cell, ".") and cell not in MISSING:
                return (
                    f"{sanitize(split_header_into_name_and_unit(name)[0])} of sample 0 (line "
                    f"{line.number}) is {quote(cell)}, not a number; correct or drop it"
                )
    if len(names) > 1:
        return (
            "holds no rows of numbers; write a time and a coordinate in each line, below a "
            "header such as 'time [s], height [mm]'"
        )
    return (
        f"no table: line {lines[0].number}, {quote(head)}, is not separated by commas, semicolons, tabs or "
        "spaces; write columns with a time and a coordinate"
    )


# Beginning, header, end ------------------------------------------------------------------------


def _find_first_row_index(lines: Sequence[NumberedLine], dialect: Dialect) -> int:
    """Find the index of the first row of the table."""

    def fields(k: int) -> list[str]:
        return split_fields(lines[k].text, dialect.separator)

    full_rows = (
        k
        for k in range(len(lines))
        if is_table_row(cells := fields(k), dialect)
        and all(
            is_number_or_timestamp(cells[j], dialect.decimal) or cells[j] in MISSING for j in dialect.numeric
        )
    )
    full = next(full_rows, None)
    if full is None:
        numbers = ", ".join(str(j + 1) for j in dialect.numeric[:_HEADER_LINES])
        raise RecordError(
            f"no line holds numbers in each of the columns {numbers}: correct the lines, or remove a column"
        )
    start = full
    # Rows with an invalid number may precede the first valid row, below the header.
    while start and is_table_row(fields(start - 1), dialect):
        start -= 1
    return start if any(_is_header(fields(k), dialect) for k in range(start)) else full


def _is_header(fields: Sequence[str], dialect: Dialect) -> bool:
    """Return True for a line that may name the columns: enough words, and no number."""
    words = [cell for cell in fields if cell]
    return (
        len(fields) >= dialect.width
        and len(words) >= 1
        and not any(is_number_or_timestamp(cell, dialect.decimal) for cell in words)
    )


def _check_lines_above_table(head: Sequence[NumberedLine], dialect: Dialect) -> None:
    """Raise an error if the rows differ in number of fields from the header or from numbers above them."""
    numbers = [line.number for line in head if _BEGINS_WITH_NUMBER.match(line.text)]
    if len(numbers) > _MAX_NUMERIC_PREAMBLE:
        raise RecordError(
            f"{len(numbers)} lines from line {numbers[0]} on also hold numbers, but not {dialect.width} "
            f"numbers separated by {SEPARATORS[dialect.separator]} as in the lines below; write all lines in "
            "one format, or give the number of lines to skip (--skip 12)"
        )
    below: list[str] = []
    for line in reversed(head):
        fields = split_fields(line.text, dialect.separator)
        names = len(fields) > 1 and any(
            guess_column_role(split_header_into_name_and_unit(field)[0]) for field in fields
        )
        if names and not any(is_number_or_timestamp(field, dialect.decimal) for field in fields):
            numeric_below = any(is_number_or_timestamp(field, dialect.decimal) for field in below)
            if numeric_below or (not below and len(fields) < dialect.width):
                raise RecordError(
                    f"sample 0 has {len(below) or dialect.width} values for "
                    f"{len(fields)} columns (below line {line.number}); use one separator in all lines, "
                    "different from the decimal mark"
                )
            return
        below = fields


def _has_decimal_commas(lines: Sequence[NumberedLine], dialect: Dialect, decimal: str | None) -> bool:
    """Return True if commas are both separators and decimal marks; raise an error if this is ambiguous."""
    decimal_commas = has_decimal_commas(lines, dialect, decimal)
    if decimal_commas is None:
        raise RecordError(
            f"{quote(lines[0].text)} may be {dialect.width} integers, or "
            f"{dialect.width // 2} numbers with decimal commas; choose one (--decimal . or --decimal ,), or "
            "separate the numbers by semicolons"
        )
    return decimal_commas


def _read_header_names_and_units(
    head: Sequence[NumberedLine], dialect: Dialect, all_lines: Sequence[NumberedLine], start: int
) -> tuple[list[str], list[str]]:
    """Return the names and units above the rows; empty lists if the file has none."""
    rows = [_split_header_line(line.text, dialect) for line in head[-_HEADER_LINES:]]
    headers = [row for row in rows if _is_header(row, dialect)]
    if not headers:
        comments = [
            line.text.lstrip().lstrip(_COMMENTS + "/ ")
            for line in all_lines
            if line.number < start and line.text.lstrip()[0] in _COMMENTS
        ]
        rows = [_split_header_line(text, dialect) for text in comments[-3:]]
        headers = [row for row in rows if _is_header(row, dialect) and len(row) == dialect.width]
    if not headers:
        return [], []
    if not all(is_unit(cell) or cell in MISSING for cell in headers[-1]):
        return _names_and_units_of_best_header_row(headers)
    units = headers.pop()
    if headers:
        return headers[-1], units
    # The file has only a row of units, or such a row below names with numbers, such as channel numbers.
    return rows[-2] if len(rows) > 1 and len(rows[-2]) >= dialect.width else [], units


def _split_header_line(line: str, dialect: Dialect) -> list[str]:
    """Split a header by the separator of the rows, or by another one that yields as many recognized names."""
    fields = split_header(line, dialect.separator)
    if len(fields) == dialect.width or (len(fields) > dialect.width and dialect.separator != " "):
        return fields
    splits = [re.split(mark, line.strip()) for mark in _HEADER_SEPARATORS]
    in_brackets = _NAME_AND_UNIT.findall(line) if len(line) <= _MAX_ROW_CHARACTERS else []
    for cells in (*splits, in_brackets, split_header(line, " ")):
        names = [cell.strip(' "') for cell in cells]
        # a title above rows without a header may also contain a quantity
        if (
            len(names) == dialect.width
            and all(names)
            and (
                any(map(_is_time_heading, names))
                or all(map(_is_column_header, names))
                or all(map(is_unit, names))
            )
        ):
            return names
    return fields


def _names_and_units_of_best_header_row(rows: Sequence[list[str]]) -> tuple[list[str], list[str]]:
    """Return names and units from the lowest row that names a time, or else from the lowest row."""
    if any(map(_is_column_header, rows[-1])):
        return rows[-1], []
    # Loggers write processing such as averaging below the name and unit of a column.
    for row, below in zip(reversed(rows), ([], *reversed(rows)), strict=False):
        if any(map(_is_time_heading, row)):
            return row, [cell if is_unit(cell) else "" for cell in below]
    return rows[-1], []


def _is_time_heading(cell: str) -> bool:
    return guess_column_role(split_header_into_name_and_unit(cell)[0]) == TIME


def _is_column_header(cell: str) -> bool:
    """Return True for a cell with a known name, or a name with a unit."""
    name, unit = split_header_into_name_and_unit(cell)
    return guess_column_role(name) is not None or (bool(name) and unit is not None and is_unit(unit))


def _table_lines_and_notes_without_trailing_text(
    lines: Sequence[NumberedLine], dialect: Dialect
) -> tuple[list[NumberedLine], list[str]]:
    """Return the lines and notes, after dropping a truncated last row and text that follows the table."""
    rows, notes = list(lines), []
    deviating = [
        k for k, line in enumerate(rows) if _field_count_of_line(line.text, dialect) != dialect.width
    ]
    while deviating and deviating[-1] == len(rows) - 1:
        fields = split_fields(rows[-1].text, dialect.separator)
        if len(fields) > dialect.width and any(
            is_number_or_timestamp(cell, dialect.decimal) for cell in fields
        ):
            break
        if len(rows) == 1 or (len(fields) < dialect.width and len(rows) - len(deviating) < 2):
            break
        reason = (
            "is cut off"
            if is_number_or_timestamp(fields[0], dialect.decimal)
            else "is not a row of the table"
        )
        notes.append(f"line {rows.pop().number}, the last, {reason} and is dropped")
        deviating.pop()
    if deviating:
        line = rows[deviating[0]]
        raise RecordError(
            f"sample {deviating[0]} has {_field_count_of_line(line.text, dialect)} values for "
            f"{dialect.width} columns (line {line.number}); separate all lines like the others"
        )
    return rows, notes


def _field_count_of_line(line: str, dialect: Dialect) -> int:
    if '"' not in line and dialect.separator != " ":
        width = line.count(dialect.separator) + 1
        if width <= dialect.width:
            return width
    return len(trim_fields(split_fields(line, dialect.separator), dialect.width))


# Columns ---------------------------------------------------------------------------------------


def _make_columns(
    rows: Sequence[NumberedLine],
    dialect: Dialect,
    names: Sequence[str],
    units: Sequence[str],
    notes: list[str],
) -> list[Column]:
    frame = _rows_to_data_frame(rows, dialect)
    columns = []
    padding = [""] * dialect.width
    for k, heading, label in zip(range(dialect.width), [*names, *padding], [*units, *padding], strict=False):
        name, unit = name_and_unit(heading, label, notes)
        columns.append(_make_column(name, unit or None, frame[k], dialect.decimal, heading))
    return columns


def _rows_to_data_frame(rows: Sequence[NumberedLine], dialect: Dialect) -> Any:
    import pandas

    blanks = dialect.separator == " "
    # Parsing is exact by default from pandas 3 on.
    exact = {} if int(pandas.__version__.split(".")[0]) >= 3 else {"float_precision": "round_trip"}
    try:
        return pandas.read_csv(
            io.BytesIO("\n".join(line.text.strip() if blanks else line.text for line in rows).encode()),
            sep=r"\s+" if blanks else dialect.separator,
            decimal=dialect.decimal,
            header=None,
            names=range(dialect.width),
            index_col=False,
            usecols=range(dialect.width),
            skipinitialspace=True,
            keep_default_na=False,
            na_values=list(MISSING),
            skip_blank_lines=False,
            **exact,
        )
    except (ValueError, OverflowError, pandas.errors.ParserError) as error:
        words = " ".join(str(error).split())
        raise RecordError(f"cannot be read as CSV: {sanitize(words)}; write the file again") from None


def _make_column(name: str, unit: str | None, cells: Any, decimal: str, heading: str) -> Column:
    """Make a column from a pandas Series, which holds strings if a cell is not a number."""
    if cells.dtype.kind in "iuf":
        return Column(name, unit, cells.to_numpy(dtype=np.float64), heading=heading)
    texts = ["" if gap else str(cell).strip() for cell, gap in zip(cells, cells.isna(), strict=True)]
    for row, text in enumerate(texts):
        if text not in MISSING and (is_timestamp(text) or not is_number_or_timestamp(text, decimal)):
            return column_of_texts(name, unit, texts, heading, (row, text))
    values = [np.nan if text in MISSING else parse_number(text, decimal) for text in texts]
    return Column(name, unit, np.array(values), heading=heading)
