"""Files that are written beside their place first and appear all at once, or not at all."""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from granular.shared.errors import InputError


@contextlib.contextmanager
def replacing(path: Path, overwrite: bool) -> Iterator[Path]:
    """A place to write a file to, which takes its real name when all went well.

    A link stays and what it leads to is replaced; a device or a pipe is written to as it is.

    Raises
    ------
    InputError
        If there is something of that name and it may not be overwritten, if it is a directory, or
        if its directory does not exist or cannot be written to.
    """
    check_target(path, overwrite)
    if path.exists() and not path.is_file():
        yield path
        return
    place = Path(os.path.realpath(path))
    # Two processes that write the same file at once must not write into each other's part.
    part = place.with_name(f".{place.stem}.{os.getpid()}.part{place.suffix}")
    try:
        part.touch()
    except OSError as error:
        raise _unwritable(path, error) from None
    try:
        yield part
        os.replace(part, place)
    except OSError as error:
        raise _unwritable(path, error) from None
    finally:
        part.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file, over one of that name.

    Raises
    ------
    InputError
        If it cannot be written; what was there before still stands.
    """
    with replacing(path, overwrite=True) as part:
        part.write_text(text, encoding="utf-8")


def write_json(path: Path, plain: object) -> None:
    """Write plain data as a JSON file for people and programs; see `finite` and `write_text`."""
    write_text(path, json.dumps(finite(plain), indent=2, allow_nan=False) + "\n")


def finite(plain: Any) -> Any:
    """Plain data with None in place of every number that is infinite or NaN."""
    if isinstance(plain, dict):
        return {key: finite(value) for key, value in plain.items()}
    if isinstance(plain, list | tuple):
        return [finite(value) for value in plain]
    if isinstance(plain, float) and not math.isfinite(plain):
        return None
    return plain


def check_target(path: Path, overwrite: bool) -> None:
    """Refuse a file that cannot be written or may not be overwritten; see `replacing`."""
    if not path.name:
        raise InputError(f"{str(path)!r} names no file; give one, such as out/bed.gsd")
    try:
        if path.is_dir():
            raise InputError(f"{path} is a directory; name a file in it")
        if path.exists() and not overwrite:
            raise InputError(f"{path} exists; give another name, or overwrite it (--force)")
        if not path.parent.is_dir():
            raise InputError(f"there is no directory {path.parent}; make it first")
    except OSError as error:
        raise _unwritable(path, error) from None


def _unwritable(path: Path, error: OSError) -> InputError:
    return InputError(
        f"{path} cannot be written: {error.strerror or error}; make room, or give another place"
    )


def make_directory(path: Path) -> None:
    """Make a directory, and those above it, where there is none.

    Raises
    ------
    InputError
        If it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path} cannot be made: {error.strerror}; give another place") from None
