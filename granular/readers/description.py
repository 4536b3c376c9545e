"""A file that says how another is read: ``record.toml``.

It names that file by a path from itself, upwards too, or by a whole path. Of a file that does not
lie below the description, no error shows what is in it: who wrote the description need not be who
may read that file.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from granular.readers.reading import Reading, reading_from_plain
from granular.shared.errors import RecordError
from granular.shared.files import read_toml, write_text
from granular.shared.messages import quoted, visible

FILE = "file"
"""Key of the file that is described, as a path from the description."""
_MOST_BYTES = 2**20
"""Of a description; a scene, which may be longer, is not read to see that it is none."""


def is_description(path: Path) -> bool:
    """Whether a file describes a record; a scene has no key ``file``."""
    if path.suffix != ".toml" or not path.is_file() or path.stat().st_size > _MOST_BYTES:
        return False
    return FILE in read_toml(path)


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


@contextlib.contextmanager
def describing(path: Path, file: Path) -> Iterator[None]:
    """Where the file that a description names is read; see the module for what errors say."""
    try:
        yield
    except RecordError:
        if not _is_elsewhere(path, file):
            raise
        raise RecordError(
            f"{visible(path)}: {FILE} = {quoted(str(file))} cannot be read as a record; as it does "
            "not lie below the description, no more is said: read it itself"
        ) from None


def _is_elsewhere(path: Path, file: Path) -> bool:
    try:
        return file.is_file() and not file.resolve().is_relative_to(path.parent.resolve())
    except OSError:  # a name that no file can have
        return False


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
