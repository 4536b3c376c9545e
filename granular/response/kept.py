"""A response in a file, so that other commands read what one has simulated."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from granular.response.response import Response
from granular.scene.scene import Scene
from granular.shared.errors import InputError
from granular.shared.files import make_directory, read_text, write_text
from granular.shared.messages import quoted, visible

FILE = "response.json"
MOST_BYTES = 64 * 2**20


def save_response(found: Response, directory: str | Path) -> Path:
    """Write a response to ``response.json`` in a directory; the path of the file.

    Its numbers keep every bit.

    Raises
    ------
    StoreError
        If it cannot be written.
    """
    path = Path(directory) / FILE
    make_directory(path.parent)
    plain = {
        "scene": found.scene.to_plain(),
        "settings": dict(found.settings),
        "dataset": found.dataset.to_dict(),
    }
    write_text(path, json.dumps(plain) + "\n")
    return path


def load_response(directory: str | Path) -> Response:
    """Read a response that `save_response` or the command ``response`` wrote.

    Raises
    ------
    InputError
        If the directory has none, or its file is damaged.
    """
    path = Path(directory) / FILE
    if not path.exists():
        raise InputError(
            f"{quoted(str(directory))} holds no {FILE}; write one by granular-damper response "
            "SCENE -o DIR"
        )
    try:
        plain = json.loads(read_text(path, MOST_BYTES))
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise _damaged(path, str(error)) from None
    return _response_of(plain, path)


def _response_of(plain: Any, path: Path) -> Response:
    import xarray

    try:
        data = xarray.Dataset.from_dict(plain["dataset"])
        found = Response(Scene.from_plain(plain["scene"]), data, dict(plain["settings"]))
        fields = [data["displacement"], data["amplitude"], data["frequency"]]
        sound = data["displacement"].dims == ("amplitude", "frequency") and all(
            np.issubdtype(one.dtype, np.number) and one.size for one in fields
        )
        sound = sound and {"units", "long_name"} <= set(data["amplitude"].attrs)
    except InputError as error:
        raise _damaged(path, str(error)) from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _damaged(path, f"{type(error).__name__} {error}") from None
    if not sound:
        raise _damaged(path, "it has no amplitudes over frequencies")
    return found


def _damaged(path: Path, why: str) -> InputError:
    return InputError(
        f"{visible(path)} cannot be read: {why}; write it anew by granular-damper response"
    )
