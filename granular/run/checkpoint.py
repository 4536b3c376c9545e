"""The checkpoint: arrays in NumPy's format, with the manifest of the run directory.

Its archive holds a checksum of each array, and is read only where all agree. No other file needs to
be replaced together with this one.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import io
import json
import re
import stat
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from granular.run.run_directory import CHECKPOINT, is_run_directory, replace_run_file
from granular.shared.errors import StoreError
from granular.shared.files import MOST_TOML_BYTES

MANIFEST = "manifest"
"""The checkpoint's entry that holds it."""

METADATA = "zarr.json"
REMEDY = "restore it, or run the scene anew"

_LENGTH = re.compile(rb'(?<="shape": \[)\s*(?:0|[1-9]\d*)')
"""Length of an array in its metadata, which grows with the run; any number that JSON allows."""

_UNREADABLE = (ValueError, EOFError, RuntimeError, struct.error, zipfile.BadZipFile, zlib.error)
"""Errors of an archive whose bytes are not those that were written."""


@dataclasses.dataclass(frozen=True)
class Manifest:
    """Digests of a run directory: which file, and which chunk of which array, stands where."""

    files: dict[str, str]
    lengths: dict[str, int]
    chunks: dict[str, list[str]]


def write_checkpoint(path: Path, mapping: Mapping[str, Any], manifest: Manifest) -> None:
    """Replace the checkpoint of a run directory atomically."""
    plain = json.dumps(dataclasses.asdict(manifest)).encode()
    archive = io.BytesIO()
    np.savez(archive, **{**mapping, MANIFEST: np.array(plain)})
    replace_run_file(path / CHECKPOINT, archive.getvalue())


def read_checkpoint(path: Path) -> tuple[dict[str, np.ndarray], Manifest]:
    """Read the checkpoint of a run directory, and the manifest in it."""
    file = path / CHECKPOINT
    if not is_run_directory(path):
        raise StoreError(f"{path} holds no run; give the directory that a run wrote")
    with _open_run_file(file) as content:
        try:
            with zipfile.ZipFile(content) as archive:
                names = archive.namelist()
                if archive.testzip() is not None or len(names) != len({*names}):
                    raise ValueError("a checksum differs, or a name")
            content.seek(0)
            with np.load(content, allow_pickle=False) as arrays:
                saved = {name: arrays[name] for name in arrays.files}
            return saved, Manifest(**json.loads(saved.pop(MANIFEST).item()))
        except _UNREADABLE as error:
            raise StoreError(f"{file} is damaged ({error}); {REMEDY}") from None
        except (KeyError, TypeError):
            raise StoreError(f"{file} was written by another version; run the scene anew") from None


def digest_files(path: Path) -> dict[str, str]:
    """Compute the digests of all files of a run directory that holds no records yet."""
    files = {file.relative_to(path).as_posix(): file for file in path.rglob("*") if file.is_file()}
    return {name: _digest_without_length(name, file.read_bytes()) for name, file in files.items()}


def read_verified_files(path: Path, manifest: Manifest) -> dict[str, bytes]:
    """Read the files that stay as they were first written, and compare their digests."""
    contents = {name: read_run_file(path / name) for name in manifest.files}
    for name, content in contents.items():
        if _digest_without_length(name, content) != manifest.files[name]:
            raise StoreError(f"{path / name} is not what the run wrote (its digest differs); {REMEDY}")
    return contents


def read_run_file(file: Path, most_bytes: int = MOST_TOML_BYTES) -> bytes:
    """Read a file of a run directory, of at most so many bytes."""
    with _open_run_file(file) as opened:
        content = opened.read(most_bytes + 1)
    if len(content) > most_bytes:
        size = file.stat().st_size
        raise StoreError(f"{file} has {size} bytes, more than the {most_bytes} that runs write; {REMEDY}")
    return content


@contextlib.contextmanager
def _open_run_file(file: Path) -> Iterator[BinaryIO]:
    """Open a file of a run directory for reading, and say in one line what is wrong with it."""
    try:
        if not stat.S_ISREG(file.stat().st_mode):  # a pipe may never end
            raise StoreError(f"{file} is no file; {REMEDY}")
        with file.open("rb") as opened:
            yield opened
    except (FileNotFoundError, NotADirectoryError):
        raise StoreError(f"{file} is missing; {REMEDY}") from None
    except OSError as error:
        raise StoreError(f"{file} cannot be read: {error.strerror}") from None


def _digest_without_length(name: str, content: bytes) -> str:
    fixed = _LENGTH.sub(b"", content) if name.endswith(METADATA) else content
    return hashlib.sha256(fixed).hexdigest()
