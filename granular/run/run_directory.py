"""Run directory: made next to its path, moved there atomically, written to by one process."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import uuid
from pathlib import Path

from granular.shared.errors import StoreError
from granular.shared.files import HAS_LOCKS, lock_open_file

SCENE = "scene.toml"
SETTINGS = "run.json"
TRAJECTORY = "trajectory.zarr"
CHECKPOINT = "checkpoint.npz"
PART = ".part"
KNOWN = {SCENE, SETTINGS, TRAJECTORY, CHECKPOINT, CHECKPOINT + PART}
"""The files of a run directory."""


def lock_directory(path: Path) -> int | None:
    """Lock a directory, so that no other process writes to it."""
    if not HAS_LOCKS:
        return None
    # The lock is the directory's, whatever its name becomes, and ends with the process.
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
    """Unlock a directory, so that others may write to it."""
    if lock_descriptor is not None:
        os.close(lock_descriptor)


def create_partial_directory(path: Path) -> tuple[Path, int | None]:
    """Make an empty, locked directory next to a run's path, to be moved there by `move_to_final_path`."""
    try:
        target = _resolve_links(path)
        if target.is_symlink() or (target.exists() and not target.is_dir()):
            what = "a link that leads to itself" if target.is_symlink() else "a file"
            raise StoreError(f"{path} is {what}; give a new directory")
        if target.exists() and any(target.iterdir()):
            raise StoreError(f"{path} is not empty; resume the run in it, or give a new directory")
        target.parent.mkdir(parents=True, exist_ok=True)
        _remove_abandoned_parts(target)
        while True:
            # Two processes that begin a run of one name must not write into each other's part.
            part = target.with_name(f".{target.name}.{uuid.uuid4().hex[:8]}.part")
            part.mkdir()
            try:
                lock_descriptor = lock_directory(part)
            except (FileNotFoundError, StoreError):
                continue  # taken for remains by another process, before it was locked
            if part.is_dir():
                return part, lock_descriptor
            unlock_directory(lock_descriptor)
    except OSError as error:
        raise StoreError(f"{path} cannot be made: {error.strerror}") from None


def move_to_final_path(part: Path, path: Path) -> None:
    """Move a complete run directory to its path, in one step."""
    target = _resolve_links(path)
    try:
        os.replace(part, target)
    except OSError as error:
        if target.is_dir() and any(target.iterdir()):
            raise StoreError(f"another process has begun a run in {path}; give a new directory") from None
        raise StoreError(f"{path} cannot be made: {error.strerror}") from None


def _resolve_links(path: Path) -> Path:
    """Path of a run directory behind all links."""
    target = Path(os.path.realpath(path))
    if not target.name:
        raise StoreError(f"{path} is no place for a run; give a directory that is yours")
    return target


def _remove_abandoned_parts(target: Path) -> None:
    """Remove what runs of this name left that were killed while they began."""
    name = re.compile(rf"\.{re.escape(target.name)}(\.[0-9a-f]{{8}})?\.part")
    for part in target.parent.iterdir():
        if not name.fullmatch(part.name):
            continue
        with contextlib.suppress(StoreError, OSError):  # one begins there, or removes it, just now
            ours = {path.name for path in part.iterdir()} <= KNOWN
            if ours and (lock_descriptor := lock_directory(part)) is not None:
                shutil.rmtree(part, ignore_errors=True)
                unlock_directory(lock_descriptor)


def replace_run_file(file: Path, content: bytes) -> None:
    """Replace a file of a run directory in one step."""
    part = file.with_name(file.name + PART)
    part.write_bytes(content)
    os.replace(part, file)


def is_run_directory(path: Path) -> bool:
    """Test whether a directory holds a run, whole or damaged."""
    # A path that cannot be looked at holds none.
    return os.path.isfile(path / CHECKPOINT) or os.path.isdir(path / TRAJECTORY)
