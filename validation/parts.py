"""The parts of the report, each made of pieces that are kept on disk when they are done.

A piece is found again by its content: what it measures, how, with which sources and versions. So a
report that was interrupted goes on where it stopped, and nothing stale is shown.
"""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from granular.shared.errors import GranularError
from granular.shared.result_cache import ResultCache, digest

Plain = dict[str, Any]


class Piece(NamedTuple):
    """One measurement.

    Attributes
    ----------
    label : str
    key : dict
        All that tells it from others, as plain data.
    measure : callable
        Makes its result, as plain data.
    """

    label: str
    key: Plain
    measure: Callable[[], Plain]


class Part(NamedTuple):
    """A part of the report.

    Attributes
    ----------
    name : str
    pieces : callable
        The pieces; its argument is whether all of the full ones are wanted.
    """

    name: str
    pieces: Callable[[bool], Sequence[Piece]]


KEY_LENGTH = 24

FAILED = "failed"
"""Key of a piece that ended in a typed error: a failure is a result."""


def measured(
    part: Part, directory: Path | None, *, full: bool = False, progress: bool = True
) -> list[Plain]:
    """Results of all pieces of a part, those on disk included.

    Parameters
    ----------
    part : Part
    directory : Path or None
        Where finished pieces are kept, below ``pieces``; nowhere without.
    full : bool
    progress : bool
        Show a progress bar on standard error.

    Raises
    ------
    InputError
        If the directory cannot be written.
    """
    results = []
    cache = None if directory is None else ResultCache(directory / "pieces")
    for piece in _shown(part, part.pieces(full), progress):
        result: Plain | None = None if cache is None else cache.read(_key(part, piece))
        if result is None:
            try:
                result = piece.measure()
            except GranularError as stop:
                result = {FAILED: f"{type(stop).__name__}: {stop}", "label": piece.label}
            if cache is not None:
                cache.keep(_key(part, piece), result)
        results.append(result)
    return results


def _shown(part: Part, pieces: Sequence[Piece], progress: bool) -> Iterator[Piece]:
    from granular.shared.progress import progress_bar

    with progress_bar(
        total=len(pieces), desc=part.name, wanted=progress,
        bar_format="{desc} {bar:20} {n_fmt}/{total_fmt}{postfix} [{elapsed}]",
    ) as bar:  # fmt: skip
        for piece in pieces:
            bar.set_postfix_str(piece.label)
            yield piece
            bar.update()


def _key(part: Part, piece: Piece) -> str:
    content = {"key": piece.key, "part": part.name, "sources": sources(), "on": machine()}
    return f"{part.name}-{digest(content, KEY_LENGTH)}"


_SHOWING = ("report.py", "table.py", "html.py", "plotting.py", "picture.py")
"""Files that only show what was measured."""

_OWN = ("published", "sections")
"""Folders on which no part depends, or that only show."""


@cache
def sources() -> str:
    """A digest of all code that a figure may depend on."""
    import granular
    import validation

    found = hashlib.sha256()
    for package in (granular, validation):
        assert package.__file__ is not None
        for path in sorted(Path(package.__file__).parent.rglob("*.py")):
            own = path.parent.name in _OWN
            if path.name not in _SHOWING and not own:
                found.update(path.read_bytes())
    return found.hexdigest()


def machine() -> dict[str, str]:
    """The machine, and versions of what it computes with."""
    import os

    from granular.shared.version import versions

    found = {"processor": _processor(), "cores": str(os.cpu_count()), "system": platform.system()}
    return found | versions()


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
