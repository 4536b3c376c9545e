"""The manifest of a run directory: digests of what stays as it was first written.

That is the scene, the settings, and the metadata of every array but its length, which grows with
the run. It is made once, and every checkpoint carries it under its seal: no file needs to be
replaced together with another one.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from granular.shared.errors import StoreError

MANIFEST = "manifest"
"""The checkpoint's entry that holds it."""

METADATA = "zarr.json"


def new_manifest(path: Path, names: Iterable[str]) -> dict[str, str]:
    """Digests by file name, of files in a directory."""
    return {name: _digest(name, (path / name).read_bytes()) for name in names}


def manifest_of(checkpoint: Mapping[str, np.ndarray]) -> dict[str, str]:
    """The manifest that a checkpoint carries."""
    return dict(json.loads(str(checkpoint[MANIFEST])))


def unchanged_bytes(path: Path, name: str, manifest: Mapping[str, str]) -> bytes:
    """The content of a file that the manifest knows.

    Raises
    ------
    StoreError
        If it is missing, cannot be read, or is not what the run wrote.
    """
    content = file_bytes(path / name)
    if _digest(name, content) != manifest.get(name):
        raise StoreError(
            f"{path / name} is not what the run wrote (its digest differs); restore it, or run the "
            "scene anew"
        )
    return content


def file_bytes(file: Path) -> bytes:
    """The content of a file of a run.

    Raises
    ------
    StoreError
        If it is missing or cannot be read.
    """
    try:
        return file.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise StoreError(f"{file} is missing; restore it, or run the scene anew") from None
    except OSError as error:
        raise StoreError(f"{file} cannot be read: {error.strerror}") from None


def _digest(name: str, content: bytes) -> str:
    if name.endswith(METADATA):
        content = _without_lengths(content)
    return hashlib.sha256(content).hexdigest()


def _without_lengths(content: bytes) -> bytes:
    try:
        return json.dumps(_fixed(json.loads(content)), sort_keys=True).encode()
    except (ValueError, RecursionError):
        return content  # no metadata at all


def _fixed(plain: Any) -> Any:
    if isinstance(plain, dict):
        return {
            key: value[1:] if key == "shape" and isinstance(value, list) else _fixed(value)
            for key, value in plain.items()
        }
    return [_fixed(value) for value in plain] if isinstance(plain, list) else plain
