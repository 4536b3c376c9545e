"""The main public names have a runnable example in their docstring.

`examples.txt` lists these names; the mark "long" means that the example runs a simulation or a fit.
"""

import doctest
import importlib
import inspect
from pathlib import Path
from typing import Any

import pytest

LISTED = [line.split() for line in (Path(__file__).parent / "examples.txt").read_text().splitlines()]
LONG = [pytest.param(name, marks=[pytest.mark.long] if mark else []) for name, *mark in LISTED]


def named(path: str) -> Any:
    """Return the object with a dotted name such as `granular.simulate`."""
    parts = path.split(".")
    for length in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:length]))
        except ModuleNotFoundError:
            continue
        for part in parts[length:]:
            found = getattr(found, part)
        return found
    raise AssertionError(f"{path} does not exist")


def test_at_least_sixty_public_names_have_an_example() -> None:
    assert len({name for name, *_ in LISTED}) >= 60


@pytest.mark.parametrize("name", LONG)
def test_each_example_in_a_docstring_prints_the_output_shown_below_it(name: str) -> None:
    text = inspect.getdoc(named(name)) or ""
    example = doctest.DocTestParser().get_doctest(text, {}, name, None, None)
    assert any(one.want for one in example.examples), f"{name} has no example with an output"
    runner = doctest.DocTestRunner(verbose=False)
    said: list[str] = []
    runner.run(example, out=said.append)
    assert runner.failures == 0, "".join(said)
