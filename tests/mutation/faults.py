"""Faults that can be planted in a source file, each one small change of its syntax tree."""

import ast
import copy
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import NamedTuple

AREAS = {
    "effects": ("granular/effects",),
    "engine": ("granular/engine",),
    "pairs": ("granular/pairs",),
    "fitting": ("reduced_models/fitting",),
}
"""Folders from which faults are drawn, in turn."""

KINDS = ("sign", "factor", "index", "comparison", "dropped")


class Fault(NamedTuple):
    """A fault, with the changed position of a file and its new text."""

    path: str
    line: int
    kind: str
    begin: int
    end: int
    before: str
    after: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line} {self.kind}: {short(self.before)} -> {short(self.after)}"

    def planted(self, source: str) -> str:
        """Return the file's text with the fault."""
        data = source.encode()
        return (data[: self.begin] + self.after.encode() + data[self.end :]).decode()


def short(text: str, most: int = 60) -> str:
    """Return a text on one line, cut after `most` characters."""
    line = " ".join(text.split())
    return line if len(line) <= most else f"{line[:most]}..."


def drawn(root: Path, seed: int, count: int) -> list[Fault]:
    """Draw `count` faults of random kinds and positions, from the folders in turn, by the seed."""
    random = Random(seed)
    areas = {name: by_kind(root, folders) for name, folders in AREAS.items()}
    found: list[Fault] = []
    while len(found) < count:
        left = [one for one in areas.values() if any(one.values())]
        if not left:
            raise ValueError(f"{count} faults are wanted, and there are {len(found)} places")
        for kinds in left[: count - len(found)]:
            kind = random.choice([name for name, places in kinds.items() if places])
            found.append(kinds[kind].pop(random.randrange(len(kinds[kind]))))
    return found


def by_kind(root: Path, folders: tuple[str, ...]) -> dict[str, list[Fault]]:
    """Return all possible faults in the files of some folders, by kind."""
    found: dict[str, list[Fault]] = {kind: [] for kind in KINDS}
    for folder in folders:
        for path in sorted((root / folder).rglob("*.py")):
            name = path.relative_to(root).as_posix()
            for fault in faults(path.read_text(encoding="utf-8"), name):
                found[fault.kind].append(fault)
    return found


def faults(source: str, path: str) -> Iterator[Fault]:
    """Return all possible faults in a file, in the order of its text."""
    begins = [0]
    for line in source.encode().splitlines(keepends=True):
        begins.append(begins[-1] + len(line))
    for node, indices in _places(ast.parse(source)):
        begin = begins[node.lineno - 1] + node.col_offset
        end = begins[(node.end_lineno or 0) - 1] + (node.end_col_offset or 0)
        before = source.encode()[begin:end].decode()
        for kind, after in _changes(node, indices):
            yield Fault(path, node.lineno, kind, begin, end, before, after)


def _places(tree: ast.Module) -> Iterator[tuple[ast.expr | ast.stmt, frozenset[str]]]:
    """Yield the nodes of function bodies and module constants, each with the names used as indices in its
    function.
    """
    for statement in tree.body:
        for function in ast.walk(statement):
            if isinstance(function, ast.FunctionDef):
                names = frozenset(
                    node.slice.id
                    for node in ast.walk(function)
                    if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Name)
                )
                for inner in function.body:
                    if not isinstance(inner, ast.FunctionDef | ast.ClassDef):
                        yield from ((node, names) for node in _nodes(inner))
        if isinstance(statement, ast.Assign) and _is_number(statement.value):
            yield statement.value, frozenset()


def _nodes(node: ast.AST) -> Iterator[ast.expr | ast.stmt]:
    if isinstance(node, ast.Raise | ast.JoinedStr | ast.FunctionDef | ast.ClassDef | ast.Lambda):
        return
    if isinstance(node, ast.expr | ast.stmt):
        yield node
    for name, child in ast.iter_fields(node):
        if name in ("annotation", "returns"):
            continue
        for one in child if isinstance(child, list) else [child]:
            if isinstance(one, ast.AST):
                yield from _nodes(one)


def _is_number(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


_SIGNS: dict[type, ast.operator] = {ast.Add: ast.Sub(), ast.Sub: ast.Add()}
_PRODUCTS: dict[type, ast.operator] = {ast.Mult: ast.Div(), ast.Div: ast.Mult()}
_COMPARISONS: dict[type, ast.cmpop] = {
    ast.Lt: ast.Gt(),
    ast.Gt: ast.Lt(),
    ast.LtE: ast.GtE(),
    ast.GtE: ast.LtE(),
    ast.Eq: ast.NotEq(),
    ast.NotEq: ast.Eq(),
}


def _changes(node: ast.expr | ast.stmt, indices: frozenset[str]) -> Iterator[tuple[str, str]]:
    """Return kind and new text of every possible change of a node itself, without its children."""
    match node:
        case ast.BinOp(op=ast.Add() | ast.Sub()) | ast.AugAssign(op=ast.Add() | ast.Sub()):
            yield "sign", _with(node, op=_SIGNS[type(node.op)])
        case ast.BinOp(op=ast.Mult() | ast.Div()):
            yield "factor", _with(node, op=_PRODUCTS[type(node.op)])
            yield "factor", f"({ast.unparse(node.left)})"  # the second factor is dropped
            if _is_number(node.left):
                yield "factor", _with(node, left=ast.Constant(2 * node.left.value))
        case ast.UnaryOp(op=ast.USub()) if not _is_number(node.operand):
            yield "sign", f"({ast.unparse(node.operand)})"
        case ast.Constant() if _is_number(node) and not indices and node.value:
            yield "factor", ast.unparse(ast.Constant(2 * node.value))
        case ast.Subscript(slice=ast.Constant(value=0 | 1 as at)) if type(at) is int:
            yield "index", _with(node, slice=ast.Constant(1 - at))
        case ast.Subscript(slice=ast.Name(id=name)) if name in indices:
            for other in sorted(indices - {name}):
                yield "index", _with(node, slice=ast.Name(other))
        case ast.Compare(ops=[op]) if type(op) in _COMPARISONS:
            yield "comparison", _with(node, ops=[_COMPARISONS[type(op)]])
        case ast.Expr(value=ast.Call()):
            yield "dropped", "pass"
    if isinstance(node, ast.AugAssign):
        yield "dropped", "pass"


def _with(node: ast.expr | ast.stmt, **fields: object) -> str:
    changed = copy.copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return ast.unparse(changed)
