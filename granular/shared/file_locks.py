"""Files that let one process at a time do something."""

from __future__ import annotations

import contextlib
import errno
import importlib.util
import os
from collections.abc import Iterator
from pathlib import Path

HAS_LOCKS = importlib.util.find_spec("fcntl") is not None
"""False on systems without file locks, where nothing keeps two processes apart."""

WITHOUT_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS)


@contextlib.contextmanager
def lock_file(path: Path, wait: bool) -> Iterator[bool]:
    """Lock a file while the block runs, against other processes."""
    if not HAS_LOCKS:
        yield True
        return
    held = _try_lock(path, wait)
    if held is None:
        yield False
        return
    try:
        yield True
    finally:
        path.unlink(missing_ok=True)  # before others have it, who look whether it is still there
        os.close(held)


def lock_open_file(opened: int, wait: bool) -> None:
    """Lock an open file or directory until it is closed; only where `HAS_LOCKS` is True."""
    import fcntl

    fcntl.flock(opened, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)


def _try_lock(path: Path, wait: bool) -> int | None:
    while True:
        held = os.open(path, os.O_CREAT | os.O_RDWR, 0o666)
        try:
            lock_open_file(held, wait)
            if _is_current_lock(held, path):
                return held
        except BlockingIOError:
            os.close(held)
            return None
        except OSError as error:
            # Some network file systems know no locks; refusing would shut their users out of every run.
            if error.errno in WITHOUT_LOCKS:
                return held
            os.close(held)
            raise
        os.close(held)


def _is_current_lock(held: int, path: Path) -> bool:
    """Return False where the file was taken away, by who held it before, and made anew."""
    try:
        return os.path.samestat(os.fstat(held), path.stat())
    except FileNotFoundError:
        return False
