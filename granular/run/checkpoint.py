"""The checkpoint's file: arrays in NumPy's format, sealed by a digest of all its bytes.

The seal stands in the comment at the end of the archive, so that the file stays what `numpy.load`
reads.
"""

from __future__ import annotations

import hashlib
import io
import os
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from granular.run.directory import CHECKPOINT, CHECKPOINT_PART, is_run
from granular.run.manifest import file_bytes
from granular.shared.errors import StoreError

_SEAL = 64  # signs of a SHA-256 in hexadecimal


def write_checkpoint(path: Path, kept: Mapping[str, Any]) -> None:
    """Replace the checkpoint of a run directory, all at once."""
    part = path / CHECKPOINT_PART
    part.write_bytes(_sealed(kept))
    os.replace(part, path / CHECKPOINT)


def read_checkpoint(path: Path) -> dict[str, np.ndarray]:
    """The checkpoint of a run directory.

    Raises
    ------
    StoreError
        If there is none, it cannot be read, or it is not what the run wrote.
    """
    file = path / CHECKPOINT
    if not is_run(path):
        raise StoreError(f"{path} holds no run; give the directory that a run wrote")
    content = file_bytes(file)
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            kept = {name: archive[name] for name in archive.files}
    except (
        OSError, EOFError, ValueError, KeyError, RuntimeError, OverflowError, MemoryError,
        TypeError, AttributeError, zipfile.BadZipFile, zlib.error,
    ) as error:  # fmt: skip
        raise _damaged(file, str(error)) from None
    if content[-_SEAL:] != _digest(content[:-_SEAL]):
        raise _damaged(file, "its digest differs")
    return kept


def _sealed(kept: Mapping[str, Any]) -> bytes:
    archive = io.BytesIO()
    np.savez(archive, **kept)
    with zipfile.ZipFile(archive, "a") as file:
        file.comment = bytes(_SEAL)
    content = archive.getvalue()[:-_SEAL]
    return content + _digest(content)


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()


def _damaged(file: Path, why: str) -> StoreError:
    return StoreError(f"{file} is damaged ({why}); restore it, or run the scene anew")
