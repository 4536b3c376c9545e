"""Malicious files give an error of one line or a record, within 2 GB and 20 s of processor time."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from .hostile_files import HOSTILE

for needed in ("openpyxl", "nptdms", "pyarrow", "h5py", "pyuff", "asammdf"):
    pytest.importorskip(needed)
resource = pytest.importorskip("resource")
pytestmark = pytest.mark.skipif(not hasattr(resource, "prlimit"), reason="memory is not limited here")

MOST_MEGABYTES, MOST_SECONDS, MOST_AFTER_A_STOP = 2048, 20, 10
"""Seconds are of the processor, which other work does not lengthen; after a stop by the clock."""
MOST_WAIT = 600


MEASURED = """
import json, resource, subprocess, sys
code = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([code, used.ru_maxrss / 1024, used.ru_utime + used.ru_stime]))
"""
"""Runs a command, and prints its exit code, memory [MB] and processor time [s]: a process that a large
one starts, as these tests, counts the memory of that one as its own."""


def look_at(path: Path, *before: str) -> subprocess.Popen[str]:
    """Run the command ``look`` on a file, with a memory limit (RLIMIT_AS) in case the file expands."""
    process = subprocess.Popen(
        [*before, sys.executable, "-m", "reduced_models", "look", str(path)],
        stdout=subprocess.PIPE if before else subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"COLUMNS": "80"},
    )
    resource.prlimit(process.pid, resource.RLIMIT_AS, (8 * 2**30,) * 2)
    return process


def written(folder: Path, name: str) -> Path:
    file, write = HOSTILE[name]
    write(folder / file)
    return folder / file


def check(path: Path) -> None:
    """Assert that the file is read or refused, by processes that use little memory and time."""
    process = look_at(path, sys.executable, "-c", MEASURED)
    measured, told = process.communicate(timeout=MOST_WAIT)
    code, megabytes, seconds = json.loads(measured)
    assert code in (0, 2), told[-500:]
    assert "Traceback" not in told
    assert told.count("\n") == 1 or code == 0, told
    assert megabytes < MOST_MEGABYTES
    assert seconds < MOST_SECONDS


@pytest.mark.parametrize("name", ["bomb: far cell", "bomb: shape", "bomb: commas"])
def test_a_sample_of_malicious_files_is_read_or_refused_with_little_memory_and_time(
    name: str, tmp_path: Path
) -> None:
    check(written(tmp_path, name))


@pytest.mark.long
@pytest.mark.parametrize("name", HOSTILE)
def test_all_malicious_files_are_read_or_refused_with_little_memory_and_time(
    name: str, tmp_path: Path
) -> None:
    check(written(tmp_path, name))


@pytest.mark.long
@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("name", [name for name in HOSTILE if name.startswith("bomb: ")])
def test_ctrl_c_ends_the_reading_of_a_file_that_expands(name: str, tmp_path: Path) -> None:
    process = look_at(written(tmp_path, name))
    time.sleep(1.5)  # until reading has begun
    process.send_signal(signal.SIGINT)
    start = time.monotonic()
    _said, told = process.communicate(timeout=MOST_WAIT)
    assert time.monotonic() - start < MOST_AFTER_A_STOP
    assert "Traceback" not in told
