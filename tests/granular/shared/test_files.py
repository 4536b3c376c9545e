"""Files written completely or not at all, private cache folders, and exclusive locks."""

import importlib.util
import json
import math
import os
import resource
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from granular import PistonRecord, load_scene
from granular.shared.errors import InputError, StoreError
from granular.shared.files import (
    lock_file,
    read_sealed_file,
    toolkit_cache_folder,
    trusted_cache_folder,
    write_atomically,
    write_json,
    write_sealed_file,
    write_text,
)
from granular.shared.html_pages import Page

RECORD = PistonRecord(np.linspace(0.0, 1.0, 5), np.linspace(0.01, 0.02, 5))
WRITERS: dict[str, Callable[[Path], None]] = {
    "text": lambda path: write_text(path, "words\n"),
    "JSON": lambda path: write_json(path, {"a": [1.0, math.nan]}),
    "scene": load_scene("bed").save,
    "page": Page("title", "words").save,
    "CSV": RECORD.to_csv,
}


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_a_file_is_replaced_completely_or_not_at_all(write: Callable[[Path], None], tmp_path: Path) -> None:
    path = tmp_path / "file"
    write(path)
    first = path.read_bytes()
    assert first
    path.write_text("something else that is longer " * 1000, encoding="utf-8")
    write(path)
    assert path.read_bytes() == first
    assert os.listdir(tmp_path) == ["file"]
    for place, words in (
        (tmp_path / "nowhere" / "file", "does not exist; make it first"),
        (tmp_path, "is a directory"),
        (tmp_path / ("x" * 300), "cannot be written: .*; free space, or give another path"),
    ):
        with pytest.raises(InputError, match=words):
            write(place)


def test_interrupted_writing_leaves_the_old_file_unchanged(tmp_path: Path) -> None:
    path = tmp_path / "file"
    write_text(path, "before")

    def interrupted() -> None:
        with write_atomically(path, overwrite=True) as part:
            part.write_text("half", encoding="utf-8")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text(encoding="utf-8") == "before"
    assert os.listdir(tmp_path) == ["file"]


def test_a_full_disk_keeps_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "file"
    write_text(path, "before")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))  # as on a disk with so much room
    try:
        with pytest.raises(StoreError, match="cannot be written: File too large; free space"):
            write_text(path, "words " * 1000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_text(encoding="utf-8") == "before"
    assert os.listdir(tmp_path) == ["file"]


FULL = Path("/dev/full")


@pytest.mark.skipif(not FULL.exists(), reason="no device is always full here")
def test_writing_to_a_full_device_is_reported() -> None:
    with pytest.raises(StoreError, match="/dev/full cannot be written: No space left on device"):
        write_text(FULL, "words")
    with FULL.open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "granular", "scenes"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert (done.returncode, done.stderr.count("\n")) == (1, 1), done.stderr
    assert "standard output or a file: No space left on device" in done.stderr


def test_non_finite_numbers_are_null_in_json(tmp_path: Path) -> None:
    write_json(tmp_path / "file", {"a": [1.0, math.nan, (math.inf, 2)]})
    assert json.loads((tmp_path / "file").read_text()) == {"a": [1.0, None, [None, 2]]}


def test_writing_through_a_link_keeps_the_link_and_replaces_its_target(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("file")
    for words in ("first", "second"):  # the first time it leads nowhere
        write_text(tmp_path / "link", words)
        assert (tmp_path / "link").is_symlink()
        assert (tmp_path / "file").read_text(encoding="utf-8") == words


def test_a_pipe_is_written_to_directly(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    writer = threading.Thread(target=write_text, args=(tmp_path / "pipe", "words"))
    writer.start()
    assert (tmp_path / "pipe").read_text(encoding="utf-8") == "words"
    writer.join()
    assert (tmp_path / "pipe").is_fifo()


@pytest.mark.parametrize("given", ["", "relative", "~/caches", None])
def test_a_relative_path_in_xdg_cache_home_is_ignored(
    given: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    if given is not None:
        monkeypatch.setenv("XDG_CACHE_HOME", given)
    assert toolkit_cache_folder() == tmp_path / ".cache" / "granular-damper"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    assert toolkit_cache_folder() == tmp_path / "caches" / "granular-damper"


def test_missing_home_directory_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", homeless)
    assert toolkit_cache_folder() is None
    with pytest.warns(UserWarning, match="the user has no home directory; set MY_CACHE to a folder"):
        assert trusted_cache_folder(None, "MY_CACHE") is None


def test_cache_folder_can_be_read_only_by_its_owner(tmp_path: Path) -> None:
    folder = trusted_cache_folder(tmp_path / "a" / "b", "MY_CACHE")
    assert folder == tmp_path / "a" / "b"
    assert folder.stat().st_mode & 0o777 == 0o700
    assert trusted_cache_folder(folder, "MY_CACHE") == folder


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="other rules hold")
@pytest.mark.parametrize("mode", [0o720, 0o702, 0o777])
def test_cache_folder_writable_by_others_is_not_used(mode: int, tmp_path: Path) -> None:
    tmp_path.chmod(mode)
    with pytest.warns(UserWarning, match="others may write to it"):
        assert trusted_cache_folder(tmp_path, "MY_CACHE") is None


@pytest.mark.skipif(getattr(os, "geteuid", lambda: 1)() != 0, reason="only root can give away")
def test_cache_files_and_folders_of_other_users_are_not_used(tmp_path: Path) -> None:
    write_sealed_file(tmp_path / "file", "label", b"content")
    os.chown(tmp_path / "file", 12345, -1)
    assert read_sealed_file(tmp_path / "file", "label") is None
    os.chown(tmp_path, 12345, -1)
    with pytest.warns(UserWarning, match="belongs to others"):
        assert trusted_cache_folder(tmp_path, "MY_CACHE") is None


def test_a_cache_file_with_a_flipped_bit_counts_as_absent(tmp_path: Path) -> None:
    path, body = tmp_path / "file", bytes(range(40))
    assert read_sealed_file(path, "label") is None
    write_sealed_file(path, "label", body)
    assert read_sealed_file(path, "label") == body
    assert read_sealed_file(path, "another label") is None
    integer = path.read_bytes()
    for bit in range(8 * len(integer)):
        content = bytearray(integer)
        content[bit // 8] ^= 1 << bit % 8
        path.write_bytes(content)
        assert read_sealed_file(path, "label") is None
    for content in (integer[:-1], integer[:20], b"", bytes(len(integer)), integer + b"\0"):
        path.write_bytes(content)
        assert read_sealed_file(path, "label") is None
    path.write_bytes(integer)
    path.chmod(0o666)
    assert read_sealed_file(path, "label") is None
    path.unlink()
    path.mkdir()
    assert read_sealed_file(path, "label") is None


def test_failed_writing_leaves_no_partial_file(tmp_path: Path) -> None:
    (tmp_path / "file").mkdir()
    with pytest.raises(OSError, match="directory"):
        write_sealed_file(tmp_path / "file", "label", b"content")
    assert os.listdir(tmp_path) == ["file"]


ROOT = Path(__file__).parents[3]
LOCKS = pytest.mark.skipif(importlib.util.find_spec("fcntl") is None, reason="no locks here")


@LOCKS
def test_a_lock_requested_without_waiting_fails_at_once_if_another_process_holds_it(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    with lock_file(path, wait=False) as first:
        with lock_file(path, wait=False) as second:
            assert (first, second) == (True, False)
        assert path.exists()
    assert not path.exists()
    with lock_file(path, wait=False) as again:
        assert again


@LOCKS
def test_processes_that_wait_for_a_lock_hold_it_one_at_a_time(tmp_path: Path) -> None:
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


@LOCKS
def test_lock_of_a_killed_process_is_released(tmp_path: Path) -> None:
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
