"""Results on a cache: found again by content, whole or not there, whoever kept them."""

import json
import math
from pathlib import Path

import pytest

from granular.shared.errors import InputError, StoreError
from granular.shared.files import ResultCache, digest

PLAIN = {"figures": {"a": 0.1 + 0.2, "b": 5e-324, "list": [1, 2.5, -0.0]}, "error": None}


def test_what_is_kept_is_found_again_to_the_bit(tmp_path: Path) -> None:
    cache = ResultCache(tmp_path / "a" / "cache")
    assert cache.read("key") is None
    cache.keep("key", PLAIN)
    assert cache.read("key") == PLAIN
    assert str(cache.read("key")) == str(PLAIN)
    cache.keep("key", {"value": math.nan, "limit": math.inf})
    found = cache.read("key")
    assert math.isnan(found["value"])
    assert found["limit"] == math.inf
    assert [one.name for one in cache.directory.iterdir()] == ["key.json"]


def test_equal_content_has_equal_keys() -> None:
    assert digest({"a": 1, "b": [0.1, "x"]}, 20) == digest({"b": [0.1, "x"], "a": 1}, 20)
    others = [{"a": 1, "b": [0.1, "y"]}, {"a": 1}, {"a": 1, "b": [0.1 + 1e-17, "x", None]}, None]
    assert len({digest(one, 20) for one in others}) == len(others)
    assert digest(PLAIN, 24).startswith(digest(PLAIN, 20))


def test_a_damaged_file_is_said_to_be_and_counts_as_nothing(tmp_path: Path) -> None:
    cache = ResultCache(tmp_path)
    cache.keep("key", PLAIN)
    integer = cache.path("key").read_bytes()
    for damaged in (b"", integer[:-3], b"\xff\xfe" + integer):
        cache.path("key").write_bytes(damaged)
        with pytest.warns(UserWarning, match="key.json is damaged; what it held is made anew"):
            assert cache.read("key") is None
    cache.keep("key", PLAIN)
    assert cache.read("key") == PLAIN


def test_a_place_that_cannot_be_read_or_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("here", encoding="utf-8")
    with pytest.raises(InputError, match=r"file cannot be made: .*; give another place"):
        ResultCache(tmp_path / "file").keep("key", PLAIN)
    assert ResultCache(tmp_path / "file").read("key") is None
    (tmp_path / "key.json").mkdir()
    with pytest.raises(StoreError, match=r"key.json cannot be read: .*; remove it"):
        ResultCache(tmp_path).read("key")
    with pytest.raises(InputError, match="is a directory"):
        ResultCache(tmp_path).keep("key", PLAIN)


def test_a_write_that_is_cut_leaves_what_was_there(tmp_path: Path) -> None:
    cache = ResultCache(tmp_path)
    cache.keep("key", PLAIN)
    with pytest.raises(TypeError):
        cache.keep("key", {"no": object()})
    assert json.loads(cache.path("key").read_text(encoding="utf-8")) == PLAIN
