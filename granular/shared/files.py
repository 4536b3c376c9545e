"""Files: reading with a maximum size, atomic writing, and caches of results and compiled code.

Files are written atomically: first to a temporary file next to the path, which is then renamed.

Sealed files contain compiled code. They are loaded only if the file and its folder belong to the user, if
nobody else may write to them, and if the digest in the file is correct.

A result cache stores plain data, one file per key. A key contains everything that determines its result, for
instance as a `digest`. Stored results therefore never become outdated.
"""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import hashlib
import importlib.util
import json
import math
import os
import re
import secrets
import stat
import tempfile
import tomllib
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from granular.shared.errors import InputError, StoreError, quote, sanitize

MOST_TOML_BYTES = 16 * 2**20
"""Maximum size of a TOML file [bytes], sufficient for the positions of 400 000 grains."""
MOST_KEY_PARTS = 20
"""Maximum number of parts of a dotted key; scenes use up to four. Parsing time grows with its square."""

_PART = r"(?:[A-Za-z0-9_-]++|\"[^\"\n]*+\"|'[^'\n]*+')"
_DOTTED = re.compile(rf"{_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{MOST_KEY_PARTS}}}")


@contextlib.contextmanager
def write_atomically(path: Path, overwrite: bool) -> Iterator[Path]:
    """Yield a temporary path to write to, which is renamed to the file after success."""
    check_output_file(path, overwrite)
    # A device or a pipe is written to directly; a link is kept, and its target is replaced.
    if path.exists() and not path.is_file():
        try:
            yield path
        except BrokenPipeError:
            raise
        except OSError as error:
            raise _unwritable_error(path, error) from None
        return
    target = Path(os.path.realpath(path))
    # Simultaneous writers of the same file, also on different machines or in threads, need separate
    # temporary files.
    unique = f"{os.getpid()}-{secrets.token_hex(4)}"
    part = target.with_name(f".{target.stem}.{unique}.part{target.suffix}")
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
    """Yield a function that gives a temporary path for each of several files, which are renamed together."""
    make_directory(directory)
    for name in names:
        check_output_file(directory / name, overwrite)
    with contextlib.ExitStack() as stack:
        yield lambda name: stack.enter_context(write_atomically(directory / name, overwrite))


def write_line_files(
    directory: Path, files: Mapping[str, Iterable[str]], overwrite: bool
) -> tuple[Path, ...]:
    """Write several text files of a directory, given by their names and lines; they are renamed together."""
    with write_files_atomically(directory, list(files), overwrite) as place_of:
        for name, lines in files.items():
            with place_of(name).open("w", encoding="utf-8") as file:
                file.writelines(lines)
    return tuple(directory / name for name in files)


def read_bytes(path: Path, most_bytes: int, error_type: type[InputError] = InputError) -> bytes:
    """Read a file of at most ``most_bytes`` bytes."""
    with convert_read_errors(path, most_bytes, error_type), path.open("rb") as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:  # for files with a reported size of 0, as in /proc
        raise _too_long_error(path, most_bytes, error_type)
    return content


def read_text(path: Path, most_bytes: int, error_type: type[InputError] = InputError) -> str:
    """Read a text file in UTF-8, with or without a byte-order mark."""
    content = read_bytes(path, most_bytes, error_type)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise error_type(f"{sanitize(path)}: cannot be read as text: {error}; save it as UTF-8") from None


@contextlib.contextmanager
def convert_read_errors(
    path: Path, most_bytes: int, error_type: type[InputError] = InputError
) -> Iterator[None]:
    """Convert any error in a block that reads a file to ``error_type``, with a one-line message."""
    name = sanitize(path)
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise error_type(f"{name}: cannot be read: it is a directory; give a file in it")
        if not stat.S_ISREG(status.st_mode):
            raise error_type(f"{name}: cannot be read: it is a pipe or a device; write it to a file first")
        if status.st_size > most_bytes:
            raise _too_long_error(path, most_bytes, error_type)
        yield
    except InputError:
        raise
    except (FileNotFoundError, NotADirectoryError):
        raise error_type(f"the file {quote(str(path))} does not exist; check the path") from None
    except OSError as error:
        if error.errno is None:
            raise
        raise error_type(f"{name}: cannot be read: {error.strerror}; check the path") from None
    except ValueError as error:
        # For a path with a null character, or one that the file system cannot encode.
        if "null" not in str(error) and not isinstance(error, UnicodeEncodeError):
            raise
        raise error_type(f"{name}: cannot be read: {error}; check the path") from None


def _too_long_error(path: Path, most_bytes: int, error_type: type[InputError]) -> InputError:
    return error_type(f"{sanitize(path)}: is too long; the limit is {most_bytes // 2**20} MB: shorten it")


def parse_toml(text: str) -> dict[str, Any]:
    """Parse a TOML text."""
    if _DOTTED.search(text):
        raise ValueError(f"a key has more than {MOST_KEY_PARTS} parts; use fewer dots")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("tables or lists are nested too deeply") from None


def read_toml(path: Path, error_type: type[InputError] = InputError) -> dict[str, Any]:
    """Read a TOML file."""
    text = read_text(path, MOST_TOML_BYTES, error_type)
    try:
        return parse_toml(text)
    except ValueError as error:
        raise error_type(f"{path}: not a TOML file: {error}") from None


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8 atomically; an existing file is replaced."""
    with write_atomically(path, overwrite=True) as part:
        part.write_text(text, encoding="utf-8")


def write_json(path: Path, plain: object) -> None:
    """Write plain data as a JSON file; numbers that are not finite become null."""
    write_text(path, json.dumps(replace_non_finite_by_none(plain), indent=2, allow_nan=False) + "\n")


def replace_non_finite_by_none(plain: Any) -> Any:
    """Copy plain data, with None in place of infinite and NaN numbers."""
    if isinstance(plain, dict):
        return {key: replace_non_finite_by_none(value) for key, value in plain.items()}
    if isinstance(plain, list | tuple):
        return [replace_non_finite_by_none(value) for value in plain]
    if isinstance(plain, float) and not math.isfinite(plain):
        return None
    return plain


def check_output_file(path: Path, overwrite: bool) -> None:
    """Raise an error if a path cannot be written to, or if it is a file that may not be replaced."""
    if not path.name:
        raise InputError(f"{str(path)!r} is not a file name; give one, such as out/bed.gsd")
    try:
        if path.is_dir():
            raise InputError(f"{path} is a directory; give a file in it")
        if path.exists() and not overwrite:
            raise InputError(f"{path} exists; give another name, or overwrite it (--force)")
        if not path.parent.is_dir():
            raise InputError(f"the directory {path.parent} does not exist; make it first")
    except OSError as error:
        raise _unwritable_error(path, error) from None


def _unwritable_error(path: Path, error: OSError) -> StoreError:
    return StoreError(
        f"{path} cannot be written: {error.strerror or error}; free space, or give another path"
    )


def make_directory(path: Path) -> None:
    """Make a directory and its parents, if missing."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"{path} cannot be made: {error.strerror}; give another path") from None


def toolkit_cache_folder() -> Path | None:
    """Return the toolkit's folder in the user's cache folder, or None if the user has no home directory."""
    # An empty or relative path is ignored, as the specification demands: it would depend on the working
    # directory.
    home = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if not home.is_absolute():
        try:
            home = Path.home() / ".cache"
        except RuntimeError:
            return None
    return home / "granular-damper"


def trusted_cache_folder(folder: Path | None, variable: str) -> Path | None:
    """Return a folder for compiled code, or None, with a warning, if it cannot be trusted or written to."""
    try:
        if folder is None:
            raise OSError("the user has no home directory")
        folder = folder.absolute()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _belongs_to_user_alone(folder.stat()):
            raise PermissionError(f"{folder} belongs to others, or others may write to it (chmod go-w)")
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        reason = f"{folder} cannot be used: {error.strerror}" if error.strerror else str(error)
        warnings.warn(
            f"compiled code is not cached, and every start compiles again: {reason}; set {variable} to a "
            "folder of yours",
            stacklevel=2,
        )
        return None
    return folder


def _belongs_to_user_alone(status: os.stat_result) -> bool:
    """Return True if a file or folder belongs to the user, and only the user may write to it."""
    if not hasattr(os, "geteuid"):
        return True  # on other systems a user's folders are private
    return status.st_uid == os.geteuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def read_sealed_file(path: Path, label: str) -> bytes | None:
    """Read a file of `write_sealed_file`; return None if it is missing, damaged, or open to other users."""
    try:
        with path.open("rb") as file:
            content = file.read() if _belongs_to_user_alone(os.fstat(file.fileno())) else b""
    except OSError:
        return None
    seal, body = content[:_SEAL], content[_SEAL:]
    return body if seal == _seal_digest(label, body) else None


def write_sealed_file(path: Path, label: str, body: bytes) -> None:
    """Write a file atomically, with a digest of label and content before the content."""
    handle, part = tempfile.mkstemp(suffix=".part", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(_seal_digest(label, body) + body)
        os.replace(part, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(part)
        raise


def _seal_digest(label: str, body: bytes) -> bytes:
    """Return the digest of a label and a file's content."""
    return hashlib.sha256(label.encode() + b"\0" + body).digest()


_SEAL = hashlib.sha256().digest_size


HAS_LOCKS = importlib.util.find_spec("fcntl") is not None
"""False on systems without file locks, where two processes can write to the same file at the same time."""

WITHOUT_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS)


@contextlib.contextmanager
def lock_file(path: Path, wait: bool) -> Iterator[bool]:
    """Lock a file while the block runs; yield False if another process has locked the file."""
    if not HAS_LOCKS:
        yield True
        return
    descriptor = _try_lock(path, wait)
    if descriptor is None:
        yield False
        return
    try:
        yield True
    finally:
        path.unlink(missing_ok=True)  # before others lock it, since they check that it still exists
        os.close(descriptor)


def lock_open_file(opened: int, wait: bool) -> None:
    """Lock an open file or directory until it is closed; needs `HAS_LOCKS`."""
    import fcntl

    fcntl.flock(opened, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)


def _try_lock(path: Path, wait: bool) -> int | None:
    while True:
        descriptor = os.open(path, os.O_CREAT | os.O_RDWR, 0o666)
        try:
            lock_open_file(descriptor, wait)
            if _is_current_lock(descriptor, path):
                return descriptor
        except BlockingIOError:
            os.close(descriptor)
            return None
        except OSError as error:
            # Some network file systems do not support locks; refusing would prevent all runs there.
            if error.errno in WITHOUT_LOCKS:
                return descriptor
            os.close(descriptor)
            raise
        os.close(descriptor)


def _is_current_lock(descriptor: int, path: Path) -> bool:
    """Return False if the process that held the lock before has removed the locked file from the path."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def digest(content: object, length: int) -> str:
    """Compute the digest of plain data in hexadecimal digits; equal data have equal digests."""
    text = json.dumps(content, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:length]


@dataclasses.dataclass(frozen=True)
class ResultCache:
    """Directory of stored results, one file per key."""

    directory: Path

    def path(self, key: str) -> Path:
        """Return the path of the file for a key."""
        return self.directory / f"{key}.json"

    def read(self, key: str, *, warn: bool = True) -> Any:
        """Read the result for a key; return None if it is missing or damaged."""
        path = self.path(key)
        try:
            return json.loads(path.read_text(encoding="utf-8"))
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            raise StoreError(
                f"{path} cannot be read: {error.strerror}; remove it, so that the result is computed again"
            ) from None
        except ValueError:
            if warn:
                warnings.warn(f"{path} is damaged; its result is computed again", stacklevel=2)
            return None

    def store(self, key: str, plain: object) -> None:
        """Store a result under a key atomically; all numbers are stored exactly, including NaN."""
        make_directory(self.directory)
        write_text(self.path(key), json.dumps(plain))
