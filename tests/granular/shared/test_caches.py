"""Folders of caches, and sealed files."""

import os
from pathlib import Path

import pytest

from granular.shared.files import (
    read_sealed_file,
    toolkit_cache_folder,
    trusted_cache_folder,
    write_sealed_file,
)


@pytest.mark.parametrize("given", ["", "relative", "~/caches", None])
def test_relative_caches_are_not_used(
    given: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    if given is not None:
        monkeypatch.setenv("XDG_CACHE_HOME", given)
    assert toolkit_cache_folder() == tmp_path / ".cache" / "granular-damper"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    assert toolkit_cache_folder() == tmp_path / "caches" / "granular-damper"


def test_no_home_directory(monkeypatch: pytest.MonkeyPatch) -> None:
    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", homeless)
    assert toolkit_cache_folder() is None
    with pytest.warns(UserWarning, match="there is no home directory; set MY_CACHE to a folder"):
        assert trusted_cache_folder(None, "MY_CACHE") is None


def test_a_folder_is_made_for_the_user_alone(tmp_path: Path) -> None:
    folder = trusted_cache_folder(tmp_path / "a" / "b", "MY_CACHE")
    assert folder == tmp_path / "a" / "b"
    assert folder.stat().st_mode & 0o777 == 0o700
    assert trusted_cache_folder(folder, "MY_CACHE") == folder


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="other rules hold")
@pytest.mark.parametrize("mode", [0o720, 0o702, 0o777])
def test_a_folder_that_others_may_write_to_is_not_used(mode: int, tmp_path: Path) -> None:
    tmp_path.chmod(mode)
    with pytest.warns(UserWarning, match="others may write to it"):
        assert trusted_cache_folder(tmp_path, "MY_CACHE") is None


@pytest.mark.skipif(getattr(os, "geteuid", lambda: 1)() != 0, reason="only root can give away")
def test_what_belongs_to_others_is_not_used(tmp_path: Path) -> None:
    write_sealed_file(tmp_path / "file", "label", b"content")
    os.chown(tmp_path / "file", 12345, -1)
    assert read_sealed_file(tmp_path / "file", "label") is None
    os.chown(tmp_path, 12345, -1)
    with pytest.warns(UserWarning, match="belongs to others"):
        assert trusted_cache_folder(tmp_path, "MY_CACHE") is None


def test_a_sealed_file_is_whole_or_absent(tmp_path: Path) -> None:
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


def test_a_file_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").mkdir()
    with pytest.raises(OSError, match="directory"):
        write_sealed_file(tmp_path / "file", "label", b"content")
    assert os.listdir(tmp_path) == ["file"]
