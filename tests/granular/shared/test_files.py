"""The one writer: a file is there whole, or what was there before still is."""

import json
import math
import os
import resource
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from granular import PistonRecord, load_scene
from granular.shared.errors import InputError, StoreError
from granular.shared.files import write_atomically, write_json, write_text
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
def test_files_are_replaced_whole(write: Callable[[Path], None], tmp_path: Path) -> None:
    path = tmp_path / "file"
    write(path)
    first = path.read_bytes()
    assert first
    path.write_text("something else that is longer " * 1000, encoding="utf-8")
    write(path)
    assert path.read_bytes() == first
    assert os.listdir(tmp_path) == ["file"]
    for place, words in (
        (tmp_path / "nowhere" / "file", "there is no directory"),
        (tmp_path, "is a directory"),
        (tmp_path / ("x" * 300), "cannot be written: .*; make room, or give another place"),
    ):
        with pytest.raises(InputError, match=words):
            write(place)


def test_what_stops_half_way_changes_nothing(tmp_path: Path) -> None:
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


def test_a_full_disk_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "file"
    write_text(path, "before")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))  # as on a disk with so much room
    try:
        with pytest.raises(StoreError, match="cannot be written: File too large; make room"):
            write_text(path, "words " * 1000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_text(encoding="utf-8") == "before"
    assert os.listdir(tmp_path) == ["file"]


FULL = Path("/dev/full")


@pytest.mark.skipif(not FULL.exists(), reason="no device is always full here")
def test_a_device_that_is_full_is_told() -> None:
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


def test_numbers_that_json_lacks_are_null(tmp_path: Path) -> None:
    write_json(tmp_path / "file", {"a": [1.0, math.nan, (math.inf, 2)]})
    assert json.loads((tmp_path / "file").read_text()) == {"a": [1.0, None, [None, 2]]}


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("file")
    for words in ("first", "second"):  # the first time it leads nowhere
        write_text(tmp_path / "link", words)
        assert (tmp_path / "link").is_symlink()
        assert (tmp_path / "file").read_text(encoding="utf-8") == words


def test_a_pipe_is_written_to(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    writer = threading.Thread(target=write_text, args=(tmp_path / "pipe", "words"))
    writer.start()
    assert (tmp_path / "pipe").read_text(encoding="utf-8") == "words"
    writer.join()
    assert (tmp_path / "pipe").is_fifo()
