"""Check public docstrings by numpydoc, refuse blocks on other names: ``python docs/docstrings.py``.

Exits with 1, and one line for each fault, unless every public function, class and method has a summary,
parameters, returns and the other parts required by numpydoc, and every other name has one line. Sections of
scene files, whose keys users write, and base classes, whose hooks others implement, may have blocks.
"""

from __future__ import annotations

import ast
import importlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType

from numpydoc.validate import validate

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "reference" / "public.md"
PACKAGES = ("granular", "reduced_models", "validation")

METHODS = (FunctionType, classmethod, staticmethod, property)

EXCEPTIONS = {
    "ES01": "a summary is enough if the parameters give the rest",
    "EX01": "examples are in the guide and are run by tests",
    "SA01": "the reference pages link names",
    # PR01 is also ignored for data classes, whose arguments are their attributes, and for errors.
    "SS05": "mistakes a plural, such as in 'Forces on each grain', for a verb",
}
"""Ignored checks, with reasons."""


BASES = {
    *(
        "Effect",
        "ForceEffect",
        "DissipativeEffect",
        "GrainsAndPistonEffect",
        "EffectContext",
        "RecordedVariable",
    ),
    *("Stage", "SplineStage", "FieldKind", "MotionIntegrals", "PlainData"),
}
"""Base classes and the data passed to their hooks, whose docstrings explain how to implement them."""

RESULTS = {
    *("FrequencyResponse", "StageResult"),
    *(
        "AtRest",
        "Quality",
        "FittedLaw",
        "HarmonicCycle",
        "RollOut",
        "Identification",
        "ComparisonRow",
        "Discovery",
    ),
    *("Calibration", "CalibratedValue", "DesignCheck", "DropScores", "DropScore", "FallSummary"),
    *("ReadOptions", "RecordOverview", "DerivedModel", "MotionError", "Instability"),
    *(
        "ConvergenceResult",
        "WorkPrecision",
        "EnergyStudy",
        "HardCaseOutcome",
        "Recommendation",
        "CaseOutcome",
    ),
}
"""Results and options of public functions, whose attributes appear in the reference pages."""

BLOCK = re.compile(r"\n\s*(Parameters|Attributes|Returns|Yields|Raises)\n\s*-{3,}")


def public_objects() -> Iterator[str]:
    """Yield the full names of public functions, of public classes and of their methods."""
    text = PAGE.read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([\w.]+)` \| (.+) \|$", text, re.MULTILINE)
    rows += re.findall(r"^### From `([\w.]+)`$\n(.*?)(?=^#)", text, re.MULTILINE | re.DOTALL)
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


def section_names(trees: list[ast.Module]) -> set[str]:
    """Names of all classes derived from `granular.schema.sections.Section`."""
    classes = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    names, before = {"Section"}, 0
    while len(names) > before:
        before = len(names)
        names |= {node.name for node in classes if names & {ast.unparse(base) for base in node.bases}}
    return names


def blocks_on_others(public: set[str]) -> Iterator[str]:
    """Yield file, line and name of each block on a name that is neither public nor a base class."""
    paths = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in paths}
    allowed = BASES | RESULTS | section_names(list(trees.values()))

    def walk(node: ast.AST, owner: str, path: Path, keeps: bool) -> Iterator[str]:
        for child in ast.iter_child_nodes(node):
            if not isinstance(child, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                yield from walk(child, owner, path, keeps)
                continue
            name = f"{owner}.{child.name}"
            kept = keeps or name in public or (isinstance(child, ast.ClassDef) and child.name in allowed)
            if not kept and BLOCK.search(ast.get_docstring(child, clean=False) or ""):
                yield f"{path.relative_to(ROOT)}:{child.lineno}: {name}: a block on a name that is not public"
            inner = kept and (child.name in BASES | RESULTS or name in public)
            yield from walk(child, name, path, isinstance(child, ast.ClassDef) and inner)

    for path, tree in trees.items():
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        yield from walk(tree, module, path, False)


def main() -> int:
    """Print every fault; return the exit code."""
    faults = 0
    public = set(public_objects())
    for fault in blocks_on_others(public):
        print(fault)
        faults += 1
    for path in sorted(public):
        result = validate(path)
        for code, message in result["errors"]:
            described = code == "PR01" and ("\nAttributes\n" in result["docstring"] or path.endswith("Error"))
            if code not in EXCEPTIONS and not described:
                print(f"{result['file']}:{result['file_line']}: {path}: {code} {message}")
                faults += 1
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
