"""Reading of files whose few bytes may stand for many, in a process of limited memory and time.

Workbooks, MATLAB's files and TDMS are squeezed, repeat cells and nest arrays: a library that reads one has no
limit of its own. If its process ends at a limit, this one goes on. What it may hand over is limited by
the readers.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from granular.shared.errors import RecordError

MAX_MEGABYTES, MAX_SECONDS = 2048, 20
"""Memory, and processor time, that one file may take: a full sheet of four columns needs half of them."""
MAX_NUMBERS = 50_000_000
"""Numbers of a file, five columns of ten million, in whatever few bytes: reading takes 1.5 GB."""
_WAIT = 6.0
"""Times the seconds after which a process that waits is ended, as on a machine with other work."""
_OUT_OF_MEMORY = 3
_AT_A_LIMIT = {_OUT_OF_MEMORY, *(-getattr(signal, name, 0) for name in ("SIGXCPU", "SIGKILL", "SIGABRT"))}
_PROGRAM = """
import json, sys
sys.path[:] = json.loads(sys.argv[1])
from granular.records.limited_process import serve
from granular.records.{module} import {function}
serve({function})
"""
_REMEDY = "save time and height alone, as CSV"

Content = tuple[Any, list[np.ndarray]]
"""Content of a file: texts, integers, lists and dicts of such, and arrays that the integers may count."""


def read_within_limits(read: Callable[[bytes], Content], content: bytes) -> Content:
    """Return what a function of a file of this room reads of bytes."""
    program = _PROGRAM.format(module=read.__module__.rpartition(".")[2], function=read.__name__)
    if not sys.executable or getattr(sys, "frozen", False):
        raise RecordError(f"is read by a Python of its own, and none is known here; {_REMEDY}")
    try:
        # Isolated, and with the present path: nothing of the working directory is run.
        done = subprocess.run(
            [sys.executable, "-I", "-c", program, json.dumps([item for item in sys.path if item])],
            input=content,
            capture_output=True,
            check=False,
            timeout=_WAIT * MAX_SECONDS,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )
    except OSError as error:
        raise RecordError(f"is read by a Python of its own, which fails: {error.strerror}") from None
    except subprocess.TimeoutExpired:
        done = None
    if done is None or done.returncode in _AT_A_LIMIT:
        raise RecordError(
            f"takes more than {MAX_MEGABYTES} MB or {MAX_SECONDS} s to read, the limits; {_REMEDY}"
        )
    if done.returncode == 1:  # Python's own, of a fault in here
        raise RuntimeError(done.stderr.decode(errors="replace"))
    if done.returncode or not done.stdout:
        raise RecordError(f"stops what reads it (code {done.returncode}); {_REMEDY}")
    answer, *arrays = np.load(io.BytesIO(done.stdout), allow_pickle=False).values()
    plain = json.loads(answer.tobytes())
    if isinstance(plain, str):
        raise RecordError(plain)
    return plain, arrays


def serve(read: Callable[[bytes], Content]) -> None:
    """Read the bytes of the standard input, and write what they hold, or why they hold nothing."""
    _set_limits()
    # What else is printed must not stand in the answer.
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    try:
        try:
            plain, arrays = read(sys.stdin.buffer.read())
        except RecordError as error:
            plain, arrays = str(error), []
        with output:
            np.savez(output, np.frombuffer(json.dumps(plain).encode(), dtype=np.uint8), *arrays)
    except MemoryError:
        sys.exit(_OUT_OF_MEMORY)


def check_count(numbers: int) -> None:
    """Refuse a file of too many numbers."""
    if numbers > MAX_NUMBERS:
        raise RecordError(
            f"holds {numbers} numbers; at most {MAX_NUMBERS} are read: save time and height alone, or sample "
            "less often"
        )


def _set_limits() -> None:
    """Limit memory and time where the system can; Windows cannot, and macOS not the memory."""
    with contextlib.suppress(ImportError):
        import resource

        wanted = {"RLIMIT_AS": MAX_MEGABYTES * 2**20, "RLIMIT_CPU": MAX_SECONDS, "RLIMIT_CORE": 0}
        for name, most in wanted.items():
            with contextlib.suppress(ValueError, OSError):
                kind = getattr(resource, name)
                hard = resource.getrlimit(kind)[1]
                resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard),) * 2)
