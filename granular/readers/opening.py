"""Files of all formats as sheets."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from granular.readers.delimited import read_delimited
from granular.readers.description import describing, is_description, read_description
from granular.readers.labview import is_labview, read_labview, read_tdms
from granular.readers.matlab import read_matlab
from granular.readers.meaning import Meaning, meaning_of
from granular.readers.parquet import read_parquet
from granular.readers.reading import Reading
from granular.readers.rigol import is_rigol, read_rigol
from granular.readers.sheet import Sheet
from granular.readers.text import decoded, read_bytes
from granular.readers.workbook import read_workbook, refuse_old
from granular.shared.errors import RecordError
from granular.shared.messages import visible

Reader = Callable[[Path, Reading], Sheet]

BINARY: dict[str, Reader] = {
    ".parquet": read_parquet,
    ".pq": read_parquet,
    ".xlsx": read_workbook,
    ".xlsm": read_workbook,
    ".ods": read_workbook,
    ".tdms": read_tdms,
    ".mat": read_matlab,
}
"""Formats that are no text, by the endings of their names."""


def read_meaning(path: Path, said: Reading, reader: Reader | None = None) -> Meaning:
    """What a file says, or the file that a description names.

    Parameters
    ----------
    path : Path
    said : Reading
        Goes before what a description says.
    reader : callable, optional
        Reads the sheet; without, by the ending of the file's name.

    Raises
    ------
    RecordError
        If it cannot be read as such; the message names the file.
    """
    if is_description(path):
        file, described = read_description(path)
        with describing(path, file):
            return _meaning(file, described.and_then(said), open_sheet)
    return _meaning(path, said, reader or open_sheet)


def _meaning(path: Path, said: Reading, reader: Reader) -> Meaning:
    sheet = reader(path, said)
    try:
        return meaning_of(sheet, said)
    except RecordError as error:
        raise RecordError(f"{visible(path)}: {error}") from None


def open_sheet(path: Path, reading: Reading) -> Sheet:
    """What stands in a file; its name's ending tells a format that is no text.

    Raises
    ------
    RecordError
        If it cannot be read as such, or what reads it is not installed.
    """
    reader = BINARY.get(path.suffix.lower())
    return read_text_sheet(path, reading) if reader is None else reader(path, reading)


def read_text_sheet(path: Path, reading: Reading) -> Sheet:
    """The table of a file of text, whatever its name.

    Raises
    ------
    RecordError
        If there is none.
    """
    content = read_bytes(path)
    refuse_old(path, content)
    text, encoding = decoded(path, content)
    if is_labview(text):
        sheet = read_labview(path, text, reading)
    elif is_rigol(text):
        sheet = read_rigol(path, text)
    else:
        sheet = read_delimited(path, text, reading.decimal, reading.skip)
    if encoding not in ("utf-8", "utf-8-sig"):
        sheet.form += f", in {encoding}"
    return sheet
