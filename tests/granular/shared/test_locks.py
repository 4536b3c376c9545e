"""Locks: one at a time, and none that stays."""

import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from granular.shared.files import lock_file

pytest.importorskip("fcntl")

ROOT = Path(__file__).parents[3]


def test_who_does_not_wait_is_told(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    with lock_file(path, wait=False) as first:
        with lock_file(path, wait=False) as second:
            assert (first, second) == (True, False)
        assert path.exists()
    assert not path.exists()
    with lock_file(path, wait=False) as again:
        assert again


def test_only_one_at_a_time_of_many_that_wait(tmp_path: Path) -> None:
    inside: list[int] = []
    most = []

    def enter(number: int) -> None:
        with lock_file(tmp_path / "lock", wait=True) as alone:
            assert alone
            inside.append(number)
            most.append(len(inside))
            time.sleep(0.001)
            inside.remove(number)

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(enter, range(100)))
    assert most == [1] * 100
    assert list(tmp_path.iterdir()) == []


def test_the_lock_of_a_process_that_is_killed_is_free(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    words = (
        "import sys, time; from pathlib import Path; from granular.shared.files import lock_file\n"
        "with lock_file(Path(sys.argv[1]), True): print('held', flush=True); time.sleep(600)"
    )
    holder = subprocess.Popen([sys.executable, "-c", words, str(path)], cwd=ROOT, stdout=subprocess.PIPE)
    assert holder.stdout is not None
    assert holder.stdout.readline() == b"held\n"
    with lock_file(path, wait=False) as alone:
        assert not alone
    holder.kill()
    holder.communicate()
    with lock_file(path, wait=False) as alone:
        assert alone
