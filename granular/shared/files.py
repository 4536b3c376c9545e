"""Files: read within limits, and written atomically, by a temporary file next to the path."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import secrets
import stat
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from granular.shared.errors import InputError, StoreError
from granular.shared.message_text import quote, sanitize

MOST_TOML_BYTES = 16 * 2**20
"""Largest file: the positions of 400 000 grains, which are read in half a minute."""
MOST_KEY_PARTS = 20
"""Most parts of a dotted key; a scene's have up to four, and the time grows with the square of them."""

_PART = r"(?:[A-Za-z0-9_-]++|\"[^\"\n]*+\"|'[^'\n]*+')"
_DOTTED = re.compile(rf"{_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{MOST_KEY_PARTS}}}")


@contextlib.contextmanager
def write_atomically(path: Path, overwrite: bool) -> Iterator[Path]:
    """Give a temporary path to write to, which takes the file's name when all went well."""
    check_output_file(path, overwrite)
    # A device or a pipe is written to as it is; a link stays, and what it leads to is replaced.
    if path.exists() and not path.is_file():
        try:
            yield path
        except BrokenPipeError:
            raise
        except OSError as error:
            raise _unwritable_error(path, error) from None
        return
    target = Path(os.path.realpath(path))
    # Two that write the same file simultaneously, also from two machines or as two threads, must
    # not write into each other's part.
    own = f"{os.getpid()}-{secrets.token_hex(4)}"
    part = target.with_name(f".{target.stem}.{own}.part{target.suffix}")
    try:
        part.touch()
    except OSError as error:
        raise _unwritable_error(path, error) from None
    try:
        yield part
        os.replace(part, target)
    except OSError as error:
        raise _unwritable_error(path, error) from None
    finally:
        part.unlink(missing_ok=True)


@contextlib.contextmanager
def write_files_atomically(
    directory: Path, names: Sequence[str], overwrite: bool
) -> Iterator[Callable[[str], Path]]:
    """Give temporary paths to write several files of a directory to, which take their names together."""
    make_directory(directory)
    for name in names:
        check_output_file(directory / name, overwrite)
    with contextlib.ExitStack() as stack:
        yield lambda name: stack.enter_context(write_atomically(directory / name, overwrite))


def write_line_files(
    directory: Path, files: Mapping[str, Iterable[str]], overwrite: bool
) -> tuple[Path, ...]:
    """Write text files of a directory by their names and lines, which take these names together."""
    with write_files_atomically(directory, list(files), overwrite) as place_of:
        for name, lines in files.items():
            with place_of(name).open("w", encoding="utf-8") as file:
                file.writelines(lines)
    return tuple(directory / name for name in files)


def read_text(path: Path, most_bytes: int, error_type: type[InputError] = InputError) -> str:
    """Read a text file in UTF-8, with or without a byte-order mark."""
    with report_read_errors(path, most_bytes, error_type):
        with path.open("rb") as file:
            content = file.read(most_bytes + 1)
        if len(content) > most_bytes:  # of a file that says that it is empty, as in /proc
            raise _too_long_error(path, most_bytes, error_type)
        try:
            return content.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise error_type(f"{sanitize(path)}: cannot be read as text: {error}; save it as UTF-8") from None


@contextlib.contextmanager
def report_read_errors(
    path: Path, most_bytes: int, error_type: type[InputError] = InputError
) -> Iterator[None]:
    """Report errors within the block, which reads a file, in one line."""
    name = sanitize(path)
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise error_type(f"{name}: cannot be read: it is a directory; name a file in it")
        if not stat.S_ISREG(status.st_mode):
            raise error_type(f"{name}: cannot be read: it is a pipe or a device; make a file of it first")
        if status.st_size > most_bytes:
            raise _too_long_error(path, most_bytes, error_type)
        yield
    except InputError:
        raise
    except (FileNotFoundError, NotADirectoryError):
        raise error_type(f"there is no file {quote(str(path))}; check the path") from None
    except OSError as error:
        if error.errno is None:
            raise
        raise error_type(f"{name}: cannot be read: {error.strerror}; check the path") from None
    except ValueError as error:
        # Of a path that holds a null character, or one that no file system can write.
        if "null" not in str(error) and not isinstance(error, UnicodeEncodeError):
            raise
        raise error_type(f"{name}: cannot be read: {error}; check the path") from None


def _too_long_error(path: Path, most_bytes: int, error_type: type[InputError]) -> InputError:
    return error_type(f"{sanitize(path)}: is too long; at most {most_bytes // 2**20} MB are read: shorten it")


def parse_toml(text: str) -> dict[str, Any]:
    """Parse a TOML text."""
    if _DOTTED.search(text):
        raise ValueError(f"a key of more than {MOST_KEY_PARTS} parts; write fewer dots")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("tables or lists too deep within each other") from None


def read_toml(path: Path, error_type: type[InputError] = InputError) -> dict[str, Any]:
    """Read a TOML file."""
    text = read_text(path, MOST_TOML_BYTES, error_type)
    try:
        return parse_toml(text)
    except ValueError as error:
        raise error_type(f"{path}: not a TOML file: {error}") from None


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8 in one step; one of that name is replaced."""
    with write_atomically(path, overwrite=True) as part:
        part.write_text(text, encoding="utf-8")


def write_json(path: Path, plain: object) -> None:
    """Write plain data as a JSON file; numbers that are not finite become null."""
    write_text(path, json.dumps(replace_non_finite_by_none(plain), indent=2, allow_nan=False) + "\n")


def replace_non_finite_by_none(plain: Any) -> Any:
    """Copy plain data, with None in place of every number that is infinite or NaN."""
    if isinstance(plain, dict):
        return {key: replace_non_finite_by_none(value) for key, value in plain.items()}
    if isinstance(plain, list | tuple):
        return [replace_non_finite_by_none(value) for value in plain]
    if isinstance(plain, float) and not math.isfinite(plain):
        return None
    return plain


def check_output_file(path: Path, overwrite: bool) -> None:
    """Refuse a path that cannot be written to, or a file that may not be replaced."""
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
        raise _unwritable_error(path, error) from None


def _unwritable_error(path: Path, error: OSError) -> StoreError:
    return StoreError(
        f"{path} cannot be written: {error.strerror or error}; make room, or give another place"
    )


def make_directory(path: Path) -> None:
    """Make a directory, and those above it, where there is none."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"{path} cannot be made: {error.strerror}; give another place") from None
