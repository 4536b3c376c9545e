"""Folders for what can be computed again, and files in them that are whole or count as absent.

What is kept here is code. It is loaded only from folders and files that belong to the user and that
nobody else may write to, and only if it is what was written.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import tempfile
import warnings
from pathlib import Path


def toolkit_cache_folder() -> Path | None:
    """Folder of the toolkit among the user's caches."""
    # An empty or relative one is ignored, as its specification says: it would be another folder in every
    # working directory.
    home = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if not home.is_absolute():
        try:
            home = Path.home() / ".cache"
        except RuntimeError:
            return None
    return home / "granular-damper"


def trusted_cache_folder(folder: Path | None, variable: str) -> Path | None:
    """Folder for compiled code, made where there is none, if it can be trusted and written to."""
    try:
        if folder is None:
            raise OSError("there is no home directory")
        folder = folder.absolute()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _belongs_to_user_alone(folder.stat()):
            raise PermissionError(f"{folder} belongs to others, or others may write to it (chmod go-w)")
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        why = f"{folder} cannot be used: {error.strerror}" if error.strerror else str(error)
        warnings.warn(
            f"compiled code is not kept, and every start compiles anew: {why}; set {variable} to a "
            "folder of your own",
            stacklevel=2,
        )
        return None
    return folder


def _belongs_to_user_alone(status: os.stat_result) -> bool:
    """Return True where something belongs to the user, and only the user may write to it."""
    if not hasattr(os, "geteuid"):
        return True  # elsewhere other rules hold, and a user's folders are private
    return status.st_uid == os.geteuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def read_sealed_file(path: Path, label: str) -> bytes | None:
    """Read what `write_sealed_file` wrote; None: no file, not the user's own, or damaged."""
    try:
        with path.open("rb") as file:
            content = file.read() if _belongs_to_user_alone(os.fstat(file.fileno())) else b""
    except OSError:
        return None
    seal, body = content[:_SEAL], content[_SEAL:]
    return body if seal == _seal_digest(label, body) else None


def write_sealed_file(path: Path, label: str, body: bytes) -> None:
    """Write a file with a digest before its content, in one step."""
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
    """Digest of a label and a content."""
    return hashlib.sha256(label.encode() + b"\0" + body).digest()


_SEAL = hashlib.sha256().digest_size
