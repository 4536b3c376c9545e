"""A file that says how another is read: ``record.toml``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from granular.readers.reading import Reading, reading_from_plain
from granular.shared.errors import RecordError
from granular.shared.files import write_text
from granular.shared.messages import quoted, visible
from granular.shared.toml import read_toml

FILE = "file"
"""Key of the file that is described, as a path from the description."""


def is_description(path: Path) -> bool:
    """Whether a file describes a record; a scene has no key ``file``."""
    return path.suffix == ".toml" and path.is_file() and FILE in read_toml(path)


def read_description(path: Path) -> tuple[Path, Reading]:
    """The file that a description names, and how it is to be read.

    Raises
    ------
    RecordError
        If it names none, or a key or a value is none of a `Reading`.
    """
    plain = dict(read_toml(path))
    name = plain.pop(FILE, None)
    if not isinstance(name, str):
        raise RecordError(f"{visible(path)}: file = {quoted(name)}; give the name of a file")
    try:
        return path.parent / name, reading_from_plain(plain)
    except RecordError as error:
        raise RecordError(f"{visible(path)}: {error}") from None


def write_description(path: Path, file: Path, reading: Reading) -> None:
    """Write a description, with the path from it to the file.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    import tomli_w

    where = path.resolve().parent
    try:
        name = Path(os.path.relpath(file.resolve(), where))
    except ValueError:  # on another drive
        name = file.resolve()
    plain: dict[str, Any] = {FILE: name.as_posix(), **reading.to_plain()}
    write_text(path, tomli_w.dumps(plain))
