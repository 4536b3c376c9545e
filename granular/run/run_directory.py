"""Run directory and its checkpoint.

The directory is first made under another name in the same folder, then renamed atomically. Only one process
writes to it. The checkpoint is an archive of arrays in NumPy's format, with a checksum of each array, and is
read only if all checksums agree. The checkpoint also holds the manifest: digests of all other files, which
reveal damage. The checkpoint can be replaced without changing any other file.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import io
import json
import os
import re
import shutil
import stat
import struct
import uuid
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from granular.shared.errors import StoreError
from granular.shared.files import HAS_LOCKS, MOST_TOML_BYTES, lock_open_file

SCENE = "scene.toml"
SETTINGS = "run.json"
TRAJECTORY = "trajectory.zarr"
CHECKPOINT = "checkpoint.npz"
PART = ".part"
RUN_FILES = {SCENE, SETTINGS, TRAJECTORY, CHECKPOINT, CHECKPOINT + PART}
"""Names of all files of a run directory."""


def lock_directory(path: Path) -> int | None:
    """Lock a directory against writing by other processes; return the lock's file descriptor, or None."""
    if not HAS_LOCKS:
        return None
    # The lock stays with the directory if it is renamed, and ends with the process.
    lock_descriptor = os.open(path, os.O_RDONLY)
    try:
        lock_open_file(lock_descriptor, wait=False)
    except BlockingIOError:
        os.close(lock_descriptor)
        raise StoreError(f"another process is running in {path}; wait for it, or stop it") from None
    except OSError:
        os.close(lock_descriptor)
        return None
    return lock_descriptor


def unlock_directory(lock_descriptor: int | None) -> None:
    """Unlock a directory for other processes."""
    if lock_descriptor is not None:
        os.close(lock_descriptor)


def create_and_lock_partial_directory(path: Path) -> tuple[Path, int | None]:
    """Make an empty, locked directory next to a run's path, for `move_to_final_path`."""
    try:
        target = _resolve_links(path)
        if target.is_symlink() or (target.exists() and not target.is_dir()):
            obstacle = "a link to itself" if target.is_symlink() else "a file"
            raise StoreError(f"{path} is {obstacle}, not a directory; give a new directory")
        if target.exists() and any(target.iterdir()):
            raise StoreError(f"{path} is not empty; resume the run in it, or give a new directory")
        target.parent.mkdir(parents=True, exist_ok=True)
        _remove_abandoned_parts(target)
        while True:
            # Processes that begin runs of the same name must not share a partial directory.
            part = target.with_name(f".{target.name}.{uuid.uuid4().hex[:8]}.part")
            part.mkdir()
            try:
                lock_descriptor = lock_directory(part)
            except (FileNotFoundError, StoreError):
                continue  # removed as abandoned by another process before it was locked
            if part.is_dir():
                return part, lock_descriptor
            unlock_directory(lock_descriptor)
    except OSError as error:
        raise StoreError(f"{path} cannot be made: {error.strerror}") from None


def move_to_final_path(part: Path, path: Path) -> None:
    """Move a complete run directory to its path atomically."""
    target = _resolve_links(path)
    try:
        os.replace(part, target)
    except OSError as error:
        if target.is_dir() and any(target.iterdir()):
            raise StoreError(f"another process has begun a run in {path}; give a new directory") from None
        raise StoreError(f"{path} cannot be made: {error.strerror}") from None


def _resolve_links(path: Path) -> Path:
    """Return the path of a run directory with all links resolved."""
    target = Path(os.path.realpath(path))
    if not target.name:
        raise StoreError(f"{path} cannot be the name of a directory; give another name")
    return target


def _remove_abandoned_parts(target: Path) -> None:
    """Remove partial directories of runs that were killed while they were creating this directory."""
    name = re.compile(rf"\.{re.escape(target.name)}(\.[0-9a-f]{{8}})?\.part")
    for part in target.parent.iterdir():
        if not name.fullmatch(part.name):
            continue
        with contextlib.suppress(StoreError, OSError):  # another process is starting there, or removing it
            ours = {path.name for path in part.iterdir()} <= RUN_FILES
            if ours and (lock_descriptor := lock_directory(part)) is not None:
                shutil.rmtree(part, ignore_errors=True)
                unlock_directory(lock_descriptor)


def replace_run_file(file: Path, content: bytes) -> None:
    """Replace a file of a run directory atomically."""
    part = file.with_name(file.name + PART)
    part.write_bytes(content)
    os.replace(part, file)


def is_run_directory(path: Path) -> bool:
    """Return True if a directory holds a run, intact or damaged."""
    # An inaccessible path does not count as a run.
    return os.path.isfile(path / CHECKPOINT) or os.path.isdir(path / TRAJECTORY)


MANIFEST = "manifest"
"""Name of the manifest in the checkpoint's archive."""

METADATA = "zarr.json"
REMEDY = "restore it, or run the scene again"

_LENGTH = re.compile(rb'(?<="shape": \[)\s*(?:0|[1-9]\d*)')
"""Pattern of an array's length in the metadata. The length grows during the run, so digests omit it."""

_UNREADABLE = (ValueError, EOFError, RuntimeError, struct.error, zipfile.BadZipFile, zlib.error)
"""Errors that reading a damaged archive can raise."""


@dataclasses.dataclass(frozen=True)
class Manifest:
    """Digests of the files and array chunks in a run directory, and the lengths of the arrays."""

    files: dict[str, str]
    lengths: dict[str, int]
    chunks: dict[str, list[str]]


def write_checkpoint(path: Path, mapping: Mapping[str, Any], manifest: Manifest) -> None:
    """Replace the checkpoint of a run directory atomically."""
    plain = json.dumps(dataclasses.asdict(manifest)).encode()
    archive = io.BytesIO()
    np.savez(archive, **{**mapping, MANIFEST: np.array(plain)})
    replace_run_file(path / CHECKPOINT, archive.getvalue())


def read_checkpoint_and_manifest(path: Path) -> tuple[dict[str, np.ndarray], Manifest]:
    """Read the checkpoint of a run directory and its manifest."""
    file = path / CHECKPOINT
    if not is_run_directory(path):
        raise StoreError(f"{path} holds no run; give the directory of a run")
    with _open_run_file(file) as content:
        try:
            with zipfile.ZipFile(content) as archive:
                names = archive.namelist()
                if archive.testzip() is not None or len(names) != len({*names}):
                    raise ValueError("a checksum or a name differs")
            content.seek(0)
            with np.load(content, allow_pickle=False) as arrays:
                saved = {name: arrays[name] for name in arrays.files}
            return saved, Manifest(**json.loads(saved.pop(MANIFEST).item()))
        except _UNREADABLE as error:
            raise StoreError(f"{file} is damaged ({error}); {REMEDY}") from None
        except (KeyError, TypeError):
            raise StoreError(
                f"{file} was written by an incompatible version of this package; run the scene again"
            ) from None


def digest_files(path: Path) -> dict[str, str]:
    """Compute the digests of all files of a run directory before the first record is written."""
    files = {file.relative_to(path).as_posix(): file for file in path.rglob("*") if file.is_file()}
    return {name: _digest_without_array_length(name, file.read_bytes()) for name, file in files.items()}


def read_verified_files(path: Path, manifest: Manifest) -> dict[str, bytes]:
    """Read the files that do not change during the run, and verify their digests."""
    contents = {name: read_run_file(path / name) for name in manifest.files}
    for name, content in contents.items():
        if _digest_without_array_length(name, content) != manifest.files[name]:
            raise StoreError(f"{path / name} has changed since it was written (the digests differ); {REMEDY}")
    return contents


def read_run_file(file: Path, max_bytes: int = MOST_TOML_BYTES) -> bytes:
    """Read a file of a run directory; the file may have at most ``max_bytes`` bytes."""
    with _open_run_file(file) as opened:
        content = opened.read(max_bytes + 1)
    if len(content) > max_bytes:
        size = file.stat().st_size
        raise StoreError(f"{file} has {size} bytes; a file of a run has at most {max_bytes} bytes; {REMEDY}")
    return content


@contextlib.contextmanager
def _open_run_file(file: Path) -> Iterator[BinaryIO]:
    """Open a file of a run directory for reading; raise `StoreError` if that fails."""
    try:
        if not stat.S_ISREG(file.stat().st_mode):  # a pipe may never end
            raise StoreError(f"{file} is not a regular file; {REMEDY}")
        with file.open("rb") as opened:
            yield opened
    except (FileNotFoundError, NotADirectoryError):
        raise StoreError(f"{file} is missing; {REMEDY}") from None
    except OSError as error:
        raise StoreError(f"{file} cannot be read: {error.strerror}") from None


def _digest_without_array_length(name: str, content: bytes) -> str:
    fixed = _LENGTH.sub(b"", content) if name.endswith(METADATA) else content
    return hashlib.sha256(fixed).hexdigest()
