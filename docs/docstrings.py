"""Validate the docstrings of all public names by numpydoc: ``python docs/docstrings.py``.

Exits with 1, and a line for each fault, unless every public function, class and method has a
summary, parameters, returns and what else numpydoc asks for.
"""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType

from numpydoc.validate import validate

PAGE = Path(__file__).parent / "reference" / "public.md"
PACKAGES = ("granular", "reduced_models", "validation")

METHODS = (FunctionType, classmethod, staticmethod, property)

EXCEPTIONS = {
    "ES01": "a summary says enough where the parameters say the rest",
    "EX01": "examples stand in the guide, where tests run them",
    "SA01": "the reference pages link names",
    # PR01 too, of data classes, whose arguments are their attributes, and of errors.
    "SS05": "takes a plural, such as in 'Forces on each grain', for a verb",
}
"""Checks that are left out, and why."""


def public_objects() -> Iterator[str]:
    """Yield the full names of public functions, of public classes and of their methods."""
    rows = re.findall(r"^\| `([\w.]+)` \| (.+) \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    for module, names in rows:
        for name in re.findall(r"`(\w+)`", names):
            public = getattr(importlib.import_module(module), name)
            home = getattr(public, "__module__", "")
            if not callable(public) or home.split(".")[0] not in PACKAGES:
                continue
            path = f"{home}.{public.__qualname__}"
            yield path
            if isinstance(public, type):
                for method, value in vars(public).items():
                    if isinstance(value, METHODS) and not method.startswith("_") and value.__doc__:
                        yield f"{path}.{method}"


def main() -> int:
    """Print every fault; return the exit code."""
    faults = 0
    for path in sorted(set(public_objects())):
        result = validate(path)
        for code, message in result["errors"]:
            described = code == "PR01" and ("\nAttributes\n" in result["docstring"] or path.endswith("Error"))
            if code not in EXCEPTIONS and not described:
                print(f"{result['file']}:{result['file_line']}: {path}: {code} {message}")
                faults += 1
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
