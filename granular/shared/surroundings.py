"""What a command finds around it, looked at before anything is imported that stumbles over it."""

from __future__ import annotations

import os

from granular.shared.errors import InputError


def check_surroundings() -> None:
    """Refuse surroundings that no command can run in.

    Raises
    ------
    InputError
        If the working directory was deleted, or the environment asks for less than one thread.
    """
    try:
        os.getcwd()
    except OSError:
        raise InputError(
            "the working directory is not there any more; change to one that is"
        ) from None
    threads = os.environ.get("NUMBA_NUM_THREADS", "").strip()
    if threads.lstrip("+-").isdecimal() and not float(threads) > 0:
        raise InputError(f"NUMBA_NUM_THREADS = {threads!r}; give at least 1, or leave it out")
