"""Reading of files whose few bytes may stand for many, in a process of limited memory and time.

Workbooks and MATLAB's files are squeezed, repeat cells and nest arrays: a library that reads one has no
limit of its own. If its process ends at a limit, this one goes on.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from granular.shared.errors import RecordError

MAX_MEGABYTES, MAX_SECONDS = 2048, 20
"""Memory, and processor time, that one file may take: a full sheet of four columns needs half of them."""
_WAIT = 6.0
"""Times the seconds after which a process that waits is ended, as on a machine with other work."""
_OUT_OF_MEMORY = 3
_ARRAY = 0  # marks the name of one
_PROGRAM = """
from granular.readers.limited_process import serve
from granular.readers.{module} import {function}
serve({function})
"""


def read_within_limits(read: Callable[[bytes], Any], content: bytes) -> Any:
    """Return what a function of a file of this room reads of bytes: arrays, texts, lists and dicts."""
    program = _PROGRAM.format(module=read.__module__.rpartition(".")[2], function=read.__name__)
    path = os.pathsep.join(filter(None, [str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH")]))
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", program],
            input=content,
            capture_output=True,
            check=False,
            timeout=_WAIT * MAX_SECONDS,
            env={**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1"},
        )
    except subprocess.TimeoutExpired:
        done = None
    if done is not None and done.returncode == 1:  # Python's own, of a fault in here
        raise RuntimeError(done.stderr.decode(errors="replace"))
    if done is None or done.returncode:
        raise RecordError(
            f"takes more than {MAX_MEGABYTES} MB or {MAX_SECONDS} s to read, the limits; "
            "save time and height alone, as CSV"
        )
    arrays = np.load(io.BytesIO(done.stdout), allow_pickle=False)
    answer = json.loads(arrays["answer"].tobytes())
    if isinstance(answer, str):
        raise RecordError(answer)
    return _with_arrays(answer, arrays)


def serve(read: Callable[[bytes], dict[str, Any]]) -> None:
    """Read the bytes of the standard input, and write what they hold, or why they hold nothing."""
    with contextlib.suppress(ImportError):  # Windows has no such limits
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MAX_MEGABYTES * 2**20,) * 2)
        resource.setrlimit(resource.RLIMIT_CPU, (MAX_SECONDS, MAX_SECONDS + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    arrays: dict[str, np.ndarray] = {}
    answer: Any
    try:
        answer = _without_arrays(read(sys.stdin.buffer.read()), arrays)
    except RecordError as error:
        answer = str(error)
    except MemoryError:
        sys.exit(_OUT_OF_MEMORY)
    written = np.frombuffer(json.dumps(answer).encode(), dtype=np.uint8)
    np.savez(sys.stdout.buffer, answer=written, **arrays)  # type: ignore[arg-type]  # no option is named so


def _without_arrays(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    """Value with the names of arrays in their place."""
    if isinstance(value, dict):
        return {name: _without_arrays(item, arrays) for name, item in value.items()}
    if not isinstance(value, np.ndarray):
        return value
    arrays[name := f"array {len(arrays)}"] = value
    return [_ARRAY, name]


def _with_arrays(value: Any, arrays: Any) -> Any:
    if isinstance(value, dict):
        return {name: _with_arrays(item, arrays) for name, item in value.items()}
    return arrays[value[1]] if isinstance(value, list) and value[:1] == [_ARRAY] else value
