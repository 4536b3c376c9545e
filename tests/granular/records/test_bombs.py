"""Small files that hold far more than a machine can read: they end soon, in one line, in 2 GB."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

from .bombs import LONG, QUICK

for needed in ("openpyxl", "nptdms", "pyarrow"):
    pytest.importorskip(needed)
pytestmark = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is not counted here")

MOST_MEGABYTES, MOST_SECONDS, MOST_AFTER_A_STOP = 2048, 60, 10
"""Seconds are of the processor, which other work does not lengthen; after a stop by the clock."""
MOST_WAIT = 600
PROGRAM = """
import json, re, resource, sys, time
from granular.commands.console import launch
from reduced_models.__main__ import main

resource.setrlimit(resource.RLIMIT_AS, (8 * 2**30, 8 * 2**30))
print("ready", flush=True)
for path in sys.argv[1:]:
    start = time.process_time()
    code = launch(main, ["look", path])
    with open("/proc/self/status") as status:
        most = int(re.search(r"VmHWM:\\s+(\\d+)", status.read())[1]) / 1024
    took = time.process_time() - start
    print(json.dumps({"code": code, "seconds": took, "MB": most}), flush=True)
"""
"""The command ``look`` on some files; RLIMIT_AS spares the machine where a bomb bursts."""


def started(paths: Sequence[Path]) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *map(str, paths)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"COLUMNS": "80"},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


def check(paths: Sequence[Path]) -> None:
    """Each is read or refused, by a process that needs little memory and time for each."""
    process = started(paths)
    said, told = process.communicate(timeout=MOST_WAIT)
    found = [json.loads(line) for line in said.splitlines() if line.startswith('{"code"')]
    assert "Traceback" not in told
    assert len(found) == len(paths), (process.returncode, told[-500:])
    for path, one in zip(paths, found, strict=True):
        assert one["code"] in (0, 2), (path.name, one)
        assert one["seconds"] < MOST_SECONDS, (path.name, one)
        assert one["MB"] < MOST_MEGABYTES, (path.name, one)


def written(folder: Path, name: str) -> Path:
    file, write = (QUICK | LONG)[name]
    write(folder / file)
    return folder / file


def test_bombs_are_refused_or_read(tmp_path: Path) -> None:
    check([written(tmp_path, name) for name in QUICK])


@pytest.mark.long
@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("name", [*QUICK, *LONG])
def test_a_bomb_ends_by_itself_and_by_ctrl_c(name: str, tmp_path: Path) -> None:
    path = written(tmp_path, name)
    assert path.stat().st_size <= 2**28
    check([path])
    process = started([path])
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    start = time.monotonic()
    _said, told = process.communicate(timeout=MOST_WAIT)
    assert time.monotonic() - start < MOST_AFTER_A_STOP
    assert "Traceback" not in told
