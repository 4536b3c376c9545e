"""A fixture that runs random trials in a separate process."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).parent
ROOT = HERE.parents[1]

Tried = Callable[..., list[dict[str, Any]]]


@pytest.fixture
def tried() -> Tried:
    """Return a function that runs a program's trials in a separate process and returns their outcomes."""

    def tried(program: str, *words: str, compiled: bool = True) -> list[dict[str, Any]]:
        paths = (str(ROOT), os.environ.get("PYTHONPATH", ""))
        surroundings = {
            "NUMBA_DISABLE_JIT": "0" if compiled else "1",
            "PYTHONPATH": os.pathsep.join(path for path in paths if path),
        }
        done = subprocess.run(
            [sys.executable, str(HERE / program), *words],
            cwd=ROOT,
            env=os.environ | surroundings,
            stdout=subprocess.PIPE,
            text=True,
            check=False,
        )
        cases = [json.loads(line) for line in done.stdout.splitlines()]
        faults = [case for case in cases if case["outcome"] == "fault"]
        assert (done.returncode, faults) == (0, []), cases[-1:]
        return cases

    return tried
