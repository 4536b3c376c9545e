"""Cached results, and the digests of functions by which any process finds these results."""

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from granular.shared.errors import InputError, StoreError
from granular.shared.files import ResultCache, digest
from granular.shared.function_digest import functions_digest

PLAIN = {"figures": {"a": 0.1 + 0.2, "b": 5e-324, "list": [1, 2.5, -0.0]}, "error": None}


def test_cached_results_keep_all_bits(tmp_path: Path) -> None:
    cache = ResultCache(tmp_path / "a" / "cache")
    assert cache.read("key") is None
    cache.store("key", PLAIN)
    assert cache.read("key") == PLAIN
    assert str(cache.read("key")) == str(PLAIN)
    cache.store("key", {"value": math.nan, "limit": math.inf})
    found = cache.read("key")
    assert math.isnan(found["value"])
    assert found["limit"] == math.inf
    assert [one.name for one in cache.directory.iterdir()] == ["key.json"]


def test_arguments_of_equal_content_have_equal_cache_keys() -> None:
    assert digest({"a": 1, "b": [0.1, "x"]}, 20) == digest({"b": [0.1, "x"], "a": 1}, 20)
    others = [{"a": 1, "b": [0.1, "y"]}, {"a": 1}, {"a": 1, "b": [0.1 + 1e-17, "x", None]}, None]
    assert len({digest(one, 20) for one in others}) == len(others)
    assert digest(PLAIN, 24).startswith(digest(PLAIN, 20))


def test_damaged_file_with_cached_results_is_reported_and_ignored(tmp_path: Path) -> None:
    cache = ResultCache(tmp_path)
    cache.store("key", PLAIN)
    integer = cache.path("key").read_bytes()
    for damaged in (b"", integer[:-3], b"\xff\xfe" + integer):
        cache.path("key").write_bytes(damaged)
        with pytest.warns(UserWarning, match="key.json is damaged; its result is computed again"):
            assert cache.read("key") is None
    cache.store("key", PLAIN)
    assert cache.read("key") == PLAIN


def test_unreadable_or_unwritable_folder_of_cached_results_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("here", encoding="utf-8")
    with pytest.raises(InputError, match=r"file cannot be made: .*; give another path"):
        ResultCache(tmp_path / "file").store("key", PLAIN)
    assert ResultCache(tmp_path / "file").read("key") is None
    (tmp_path / "key.json").mkdir()
    with pytest.raises(StoreError, match=r"key.json cannot be read: .*; remove it"):
        ResultCache(tmp_path).read("key")
    with pytest.raises(InputError, match="is a directory"):
        ResultCache(tmp_path).store("key", PLAIN)


ROOT = Path(__file__).parents[3]

HELPER = "FACTOR = {factor}\n\ndef scaled(x):\n    return FACTOR * x\n"

USER = """
import collections, enum, functools, re, sys, threading
import numpy as np
from granular.shared.function_digest import functions_digest
import helper
from helper import scaled

WORDS = {"a", "b", "c", "d"}
LOCK = threading.Lock()
PATTERN = re.compile("a+")
Kind = enum.Enum("Kind", "FIRST SECOND")
Pair = collections.namedtuple("Pair", "first second", defaults=(1.0,))

def of_module(x):
    return helper.scaled(x)

def of_function(x):
    return scaled(x)

def of_import(x):
    from helper import scaled as inner
    return inner(x)

def of_all(x):
    if x in WORDS:
        return of_all(PATTERN.sub("b", x))
    with LOCK:
        return Kind.FIRST, Pair(x), np.sin(x), functools.reduce(max, WORDS)

for function in (of_module, of_function, of_import, of_all):
    print(functions_digest({"f": function}))
"""


def digests(folder: Path, factor: float, order: str) -> list[str]:
    (folder / "helper.py").write_text(HELPER.format(factor=factor))
    (folder / "user.py").write_text(USER)
    surroundings = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONHASHSEED": order}
    words = [sys.executable, "-B", str(folder / "user.py")]
    return subprocess.check_output(words, env=surroundings, text=True).split()


def test_digest_of_a_function_is_the_same_in_any_process_and_depends_on_its_helper_files(
    tmp_path: Path,
) -> None:
    first, again, edited = (digests(tmp_path, *given) for given in ((2.0, "1"), (2.0, "2"), (3.0, "1")))
    assert first == again
    assert [one != other for one, other in zip(first, edited, strict=True)] == [True, True, True, False]


@pytest.mark.parametrize("where", [0, 1500, 2999])
def test_digest_of_a_function_depends_on_every_value_of_its_tables(where: int) -> None:
    def digest_with(value: float) -> str:
        table = np.arange(3000.0)
        table[where] = value
        rows = (table, "of a tuple")
        return functions_digest({"f": lambda x: rows[0] @ x})

    assert digest_with(-1.0) == digest_with(-1.0) != digest_with(-2.0)


def test_digest_of_a_function_includes_its_parameter_names() -> None:
    assert functions_digest({"f": abs}, ["k"]) != functions_digest({"f": abs}, ["k", "l"])
