"""Processes for measurements."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from granular.shared.errors import GranularError


class ProcessError(GranularError):
    """A process for a measurement has failed."""


def finished(
    command: Sequence[str], environment: Mapping[str, str] | None = None, index: Path | None = None
) -> str:
    """Run a command, and return its output.

    Parameters
    ----------
    command : sequence of str
    environment : mapping of str to str, optional
        Variables added to the environment of this process.
    place : Path, optional
        Directory to run it in.

    Raises
    ------
    ProcessError
        If it ends with a code other than 0.
    """
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=False,
        cwd=index,
        env=os.environ | dict(environment or {}),
    )
    if done.returncode != 0:
        lines = (done.stdout + done.stderr).strip().splitlines() or ["no words"]
        words = next((line for line in lines if line.startswith("ERROR")), lines[-1])
        raise ProcessError(f"{' '.join(command)} ended with {done.returncode}: {words}")
    return done.stdout
