"""Sources of compiled code: the kernels' files, without comments and docstrings."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).parent.parent
FOLDERS = ("compiled", "effects", "engine", "formulas", "kernel_data", "pairs", "protocol")
"""The folders of the package with the kernels and all that kernels take from other files."""

_DECORATORS = {"compiled", "entry", "intrinsic"}


def read_compiled_sources() -> dict[str, bytes]:
    """Content of every file in `FOLDERS`, by its path in the package."""
    paths = sorted(path for folder in FOLDERS for path in (PACKAGE / folder).rglob("*.py"))
    return {path.relative_to(PACKAGE).as_posix(): path.read_bytes() for path in paths}


def digest_of_bytes(files: dict[str, bytes]) -> str:
    """Digest of the files to the last byte."""
    digest = hashlib.sha256()
    for name, content in files.items():
        digest.update(f"{name}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()


def digest_of_syntax(files: dict[str, bytes]) -> str:
    """Digest of what the compiler sees of the files that hold kernels, or that these import from.

    Comments, docstrings and the places of lines are left out.
    """
    trees = {name: ast.parse(content) for name, content in files.items()}
    digest = hashlib.sha256()
    for name in sorted(_reachable_files(trees)):
        _remove_docstrings(trees[name])
        digest.update(f"{name}\0{ast.dump(trees[name])}\0".encode())
    return digest.hexdigest()


def _reachable_files(trees: dict[str, ast.Module]) -> set[str]:
    """Files that hold kernels, and those that they import from, all the way."""
    waiting = [name for name, tree in trees.items() if _has_kernels(tree)]
    result: set[str] = set()
    while waiting:
        name = waiting.pop()
        if name not in result:
            result.add(name)
            waiting += [module for module in _imports_of(trees[name]) if module in trees]
    return result


def _has_kernels(tree: ast.Module) -> bool:
    for node in ast.walk(tree):
        for decorator in getattr(node, "decorator_list", ()):
            called = decorator.func if isinstance(decorator, ast.Call) else decorator
            if isinstance(called, ast.Name) and called.id in _DECORATORS:
                return True
    return False


def _imports_of(tree: ast.Module) -> Iterator[str]:
    """Files of this package that a file may import from."""
    for node in ast.walk(tree):
        modules: list[str] = []
        if isinstance(node, ast.ImportFrom) and node.module:
            modules = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        for module in modules:
            package, *rest = module.split(".")
            if package == PACKAGE.name:
                base = "/".join(rest)
                yield from (f"{base}.py", f"{base}/__init__.py")


def _remove_docstrings(tree: ast.Module) -> None:
    """Take out docstrings: texts that stand as statements of their own."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            body[:] = [statement for statement in body if not _is_docstring(statement)]


def _is_docstring(node: ast.stmt) -> bool:
    value = node.value if isinstance(node, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)
