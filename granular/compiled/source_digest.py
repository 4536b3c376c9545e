"""Sources of compiled code: the kernels' files, without comments and docstrings."""

from __future__ import annotations

import ast
import hashlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).parent.parent
FOLDERS = ("compiled", "effects", "engine", "formulas", "kernel_data", "pairs", "protocol")
"""The folders of the package with the kernels and all that kernels take from other files."""

_KERNEL = re.compile(rb"^\s*@(compiled|entry|intrinsic)\b", re.MULTILINE)


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
    """Digest of what the compiler sees of the files that hold kernels, or that these import from."""
    waiting = [name for name, content in files.items() if _KERNEL.search(content)]
    trees: dict[str, ast.Module] = {}
    while waiting:
        name = waiting.pop()
        if name not in trees:
            trees[name] = ast.parse(files[name])
            waiting += [other for other in _remove_docstrings(trees[name]) if other in files]
    digest = hashlib.sha256()
    for name in sorted(trees):
        digest.update(f"{name}\0".encode())
        digest.update(ast.dump(trees[name]).encode())
    return digest.hexdigest()


def _remove_docstrings(tree: ast.Module) -> list[str]:
    """Take out docstrings, and return the package's files that the file may import from."""
    imports: list[str] = []
    waiting: list[Any] = [tree]
    for node in waiting:
        if isinstance(node, ast.ImportFrom | ast.Import):
            imports += _imports_of(node)
        for part in ("body", "orelse", "finalbody", "handlers", "cases"):
            inner = getattr(node, part, [])
            inner[:] = [statement for statement in inner if not _is_docstring(statement)]
            waiting += inner
    return imports


def _imports_of(node: ast.ImportFrom | ast.Import) -> Iterator[str]:
    """Files of this package that a statement may import from."""
    modules = [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        base = node.module or ""
        modules = [base, *(f"{base}.{name}" for name in modules)]
    for module in modules:
        package, *rest = module.split(".")
        if package == PACKAGE.name:
            path = "/".join(rest)
            yield from (f"{path}.py", f"{path}/__init__.py")


def _is_docstring(node: ast.stmt) -> bool:
    value = node.value if isinstance(node, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)
