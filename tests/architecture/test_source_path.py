"""The files that a source passes in `identify` are few enough to be read one after the other.

Counted from the texts of the package alone, with all that any option leads to: the files of
`reduced_models` that hold a function which `identify` can reach and which is handed the source, the
record, scene or run that it stands for, or an object that holds one of these.

Reached is what the body of a reached function names (annotations apart), constants of its module
included; of a class that is named, the methods whose names stand behind a dot in a reached body. An
object holds a record where its class, or one that it derives from, has an attribute with such an
annotation. Functions that are handed columns, or integrals of them, no longer see the source.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
MOST_FILES = 40
SOURCES = {"PistonRecord", "Scene", "Trajectory"}


class Definition(NamedTuple):
    """A function, class or method, by its module."""

    module: str
    name: str


class Package:
    """What the files of a package define, and what each definition names."""

    def __init__(self, package: str, root: Path = ROOT) -> None:
        self.files: dict[str, str] = {}
        self.trees: dict[str, ast.Module] = {}
        for path in sorted((root / package).rglob("*.py")):
            module = ".".join(path.relative_to(root).with_suffix("").parts)
            module = module.removesuffix(".__init__")
            self.files[module] = str(path.relative_to(root))
            self.trees[module] = ast.parse(path.read_text(encoding="utf-8"))
        self.definitions: dict[Definition, ast.AST] = {}
        self.names: dict[str, dict[str, Definition]] = {}
        for module, tree in self.trees.items():
            self.names[module] = {
                alias.asname or alias.name: Definition(node.module, alias.name)
                for node in ast.walk(tree)
                if isinstance(node, ast.ImportFrom) and node.module
                for alias in node.names
            }
            for node in tree.body:
                for name in defined(node):
                    self.names[module][name] = Definition(module, name)
                    self.definitions[Definition(module, name)] = node

    def resolved(self, module: str, name: str) -> Definition | None:
        """The definition that a name of a module stands for, through imports of imports."""
        here, passed = self.names[module].get(name), set()
        while here is not None and here not in self.definitions and here not in passed:
            passed.add(here)
            here = self.names.get(here.module, {}).get(here.name)
        return here if here in self.definitions else None

    def uses(self, module: str, node: ast.AST) -> Iterator[Definition]:
        """The definitions that a body names."""
        for one in without_annotations(node):
            found = None
            if isinstance(one, ast.Name):
                found = self.resolved(module, one.id)
            elif isinstance(one, ast.Attribute) and isinstance(one.value, ast.Name):
                other = self.names[module].get(one.value.id)
                if other is not None and ".".join(other) in self.names:
                    found = self.resolved(".".join(other), one.attr)
            if found is not None:
                yield found

    def reached(self, start: Definition) -> set[tuple[Definition, ast.FunctionDef]]:
        """Functions and methods that can run once a function has been called."""
        functions: set[tuple[Definition, ast.FunctionDef]] = set()
        classes: set[Definition] = set()
        attributes: set[str] = set()
        todo, passed = [start], set[Definition]()
        while todo:
            while todo:
                one = todo.pop()
                if one in passed:
                    continue
                passed.add(one)
                node = self.definitions[one]
                if isinstance(node, ast.ClassDef):
                    classes.add(one)
                    continue
                if isinstance(node, ast.FunctionDef):
                    functions.add((one, node))
                attributes |= dotted(node)
                todo += self.uses(one.module, node)
            for owner in classes:
                node = self.definitions[owner]
                assert isinstance(node, ast.ClassDef)
                todo += [base for base in self.uses(owner.module, node) if base not in passed]
                for method in node.body:
                    if not isinstance(method, ast.FunctionDef) or (owner, method) in functions:
                        continue
                    if method.name.startswith("__") or method.name in attributes:
                        functions.add((owner, method))
                        attributes |= dotted(method)
                        todo += [one for one in self.uses(owner.module, method) if one not in passed]
            # A method may name what makes others run.
            if not todo and any(
                isinstance(method, ast.FunctionDef)
                and method.name in attributes
                and (owner, method) not in functions
                for owner in classes
                for method in self.definitions[owner].body  # type: ignore[attr-defined]
            ):
                todo = [start]
                passed.discard(start)
        return functions

    def holders(self) -> set[str]:
        """Names of the classes whose objects hold a source."""
        found = set(SOURCES)
        while True:
            more = {
                one.name
                for one, node in self.definitions.items()
                if isinstance(node, ast.ClassDef)
                and one.name not in found
                and found & {name for part in held(node) for name in named(part)}
            }
            if not more:
                return found
            found |= more

    def passed(self, start: Definition) -> dict[str, list[str]]:
        """Files that hold reached functions which are handed a source, with their names."""
        holders, files = self.holders(), dict[str, list[str]]()
        for owner, function in self.reached(start):
            arguments = (*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs)
            given = {name for one in arguments if one.annotation for name in named(one.annotation)}
            if isinstance(self.definitions[owner], ast.ClassDef):
                given.add(owner.name)
            if given & holders:
                files.setdefault(self.files[owner.module], []).append(function.name)
        return files


def defined(node: ast.stmt) -> list[str]:
    """Names that a statement of a module defines."""
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else []
    if isinstance(node, ast.AnnAssign):
        targets = [node.target]
    return [one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)]


def without_annotations(node: ast.AST) -> Iterator[ast.AST]:
    """A node and all below it, but for annotations; of a class but its bases and attributes."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns"):
            continue
        for child in value if isinstance(value, list) else [value]:
            is_method = isinstance(node, ast.ClassDef) and isinstance(child, ast.FunctionDef)
            if isinstance(child, ast.AST) and not is_method:
                yield child
                yield from without_annotations(child)


def dotted(node: ast.AST) -> set[str]:
    return {one.attr for one in without_annotations(node) if isinstance(one, ast.Attribute)}


def held(node: ast.ClassDef) -> list[ast.expr]:
    """Annotations of a class's attributes, and what it derives from."""
    fields = [one.annotation for one in node.body if isinstance(one, ast.AnnAssign)]
    return [*fields, *node.bases]


def named(annotation: ast.AST) -> set[str]:
    return {one.id for one in ast.walk(annotation) if isinstance(one, ast.Name)}


IDENTIFY = Definition("reduced_models.identification.identify", "identify")


def test_files_that_a_source_passes() -> None:
    files = Package("reduced_models").passed(IDENTIFY)
    assert len(files) <= MOST_FILES, sorted(files)


def test_a_path_is_seen(tmp_path: Path) -> None:
    """Through a class that holds a record, a method, a constant, and an import of an import."""
    workspace = tmp_path / "house"
    workspace.mkdir()
    for name, text in {
        "__init__": "from house.low import Holder",
        "low": "class Holder:\n    record: PistonRecord\n    def seen(self): ...\n    def other(self): ...\n",
        "top": "from house import Holder\nfrom house.away import DEEDS\n"
        "def job(source: Scene) -> None:\n    DEEDS[0](Holder(source)).seen()\n",
        "away": "def deed(held: Holder) -> Never: ...\ndef plain(x: float): ...\n"
        "def unused(x: Scene): ...\nDEEDS = (deed, plain)\n",
        "apart": "def unused(x: Scene): ...",
    }.items():
        (workspace / f"{name}.py").write_text(text, encoding="utf-8")
    found = Package("house", tmp_path).passed(Definition("house.top", "job"))
    assert found == {"house/top.py": ["job"], "house/low.py": ["seen"], "house/away.py": ["deed"]}
