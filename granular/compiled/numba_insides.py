"""Numba's insides: `kernel_linking` and `kernel_cache` take some, which a newer version may have moved."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import warnings

import numba

from granular.compiled.cache_folder import digest_of_sources, read_or_compute
from granular.compiled.source_digest import PACKAGE

SWITCH = "GRANULAR_PLAIN_NUMBA"
"""Variable of the environment: 1 for Numba's own ``njit``, 0 for the insides, whatever the version."""

TESTED = (0, 64), (0, 68)
"""First and last version of Numba that the tests were run with."""


def insides_are_usable() -> bool:
    """Return whether kernels are compiled by Numba's insides; warn once where they no longer fit."""
    chosen = os.environ.get(SWITCH, "")
    if chosen:
        return chosen == "0"
    version = tuple(int(number) for number in re.findall(r"\d+", numba.__version__)[:2])
    if numba.config.DISABLE_JIT or TESTED[0] <= version <= TESTED[1]:
        return True
    fault = read_or_compute("insides", digest_of_sources(), _find_fault)
    if fault:
        tested = " to ".join(f"{major}.{minor}" for major, minor in TESTED)
        warnings.warn(
            f"numba {numba.__version__} is outside the tested versions, {tested}, and its insides do not "
            f"fit ({fault}): its own njit compiles, with the same results and a first start twice as long",
            stacklevel=2,
        )
        os.environ[SWITCH] = "1"  # worker processes need not find out, and warn, again
    return not fault


def _find_fault() -> str:
    """Return the error that stops the trial kernels; empty if they run."""
    # In a process of its own: code that does not fit may end one without an exception.
    path = os.pathsep.join(filter(None, [str(PACKAGE.parent), os.environ.get("PYTHONPATH")]))
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, "-P", "-c", "from granular.compiled.trial_kernels import run; run()"],
            env={**os.environ, SWITCH: "0", "NUMBA_CACHE_DIR": folder, "PYTHONPATH": path},
            capture_output=True,
            text=True,
            check=False,
        )
    lines = done.stderr.strip().splitlines()
    return (lines or [f"exit code {done.returncode}"])[-1] if done.returncode else ""
