"""Digests of functions: the same in any process, and others for what a helper's file holds."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from granular.shared.function_digest import functions_digest

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


def test_a_digest_is_that_of_any_process_and_of_a_helpers_file(tmp_path: Path) -> None:
    first, again, edited = (digests(tmp_path, *given) for given in ((2.0, "1"), (2.0, "2"), (3.0, "1")))
    assert first == again
    assert [one != other for one, other in zip(first, edited, strict=True)] == [True, True, True, False]


@pytest.mark.parametrize("where", [0, 1500, 2999])
def test_a_table_counts_to_its_last_entry(where: int) -> None:
    def digest_with(value: float) -> str:
        table = np.arange(3000.0)
        table[where] = value
        rows = (table, "of a tuple")
        return functions_digest({"f": lambda x: rows[0] @ x})

    assert digest_with(-1.0) == digest_with(-1.0) != digest_with(-2.0)


def test_names_of_parameters_count() -> None:
    assert functions_digest({"f": abs}, ["k"]) != functions_digest({"f": abs}, ["k", "l"])
