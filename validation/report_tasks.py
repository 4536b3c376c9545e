"""Sections of the report: their tasks, whose results are kept on disk, and how these are shown.

A result is found again by its content: what it measures, how, with which sources and versions. So a
report that was interrupted goes on where it stopped, and nothing stale is shown.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self, get_args, get_type_hints

from granular.run.summary import custom_code_digests
from granular.shared.errors import GranularError
from granular.shared.result_cache import ResultCache, digest

if TYPE_CHECKING:
    from granular.scene.scene import Scene
    from granular.shared.html_pages import HtmlPage
    from validation.text_tables import TextTable

Plain = dict[str, Any]


class PlainData:
    """Base of results, which are frozen dataclasses, to be kept as JSON."""

    def to_plain(self) -> Plain:
        """Return the result as plain data; None for a number that is none.

        Returns
        -------
        dict of str to Any
            Fields by name, nested ones too.
        """
        plain: Plain = _to_plain(self)
        return plain

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> Self:
        """Return the result that `to_plain` made plain, also by way of JSON.

        Parameters
        ----------
        plain : mapping of str to Any
            Fields by name.

        Returns
        -------
        Self
            The result; a number that is None becomes NaN.
        """
        result: Self = _from_plain(cls, plain)
        return result


def _to_plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return {entry.name: _to_plain(getattr(value, entry.name)) for entry in dataclasses.fields(value)}
    if hasattr(value, "_asdict"):
        return {name: _to_plain(entry) for name, entry in value._asdict().items()}
    if isinstance(value, tuple):
        return [_to_plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _from_plain(kind: Any, value: Any) -> Any:
    """Value of a field of that type."""
    if value is None:
        return math.nan if kind is float else None
    if isinstance(value, list):
        first = get_args(kind)[0]
        return tuple(_from_plain(first, entry) for entry in value)
    kinds = (kind, *get_args(kind))
    records = [entry for entry in kinds if dataclasses.is_dataclass(entry) or hasattr(entry, "_fields")]
    if isinstance(value, Mapping) and records:
        hints = get_type_hints(records[0])
        return records[0](**{name: _from_plain(hints[name], entry) for name, entry in value.items()})
    return value


class Task(NamedTuple):
    """One measurement."""

    label: str
    key: Plain
    measure: Callable[[], Plain]


class Section(NamedTuple):
    """A section of the report.

    Attributes
    ----------
    name : str
    title : str
        Its heading; none for a section that writes headings of its own.
    tasks : callable
        Its tasks; the argument is whether all of the full ones are wanted.
    parse_result : callable
        A result as `tables`, `verdict` and `show` take it.
    tables : callable
        Tables of the results, by what is said of them: for the console, and for the page.
    verdict : callable
        Words on the results, and whether they hold.
    show : callable
        Adds texts, tables and figures to a page.
    tables_at_end : bool
        Whether the tables stand at the end of the page, where few will read them.
    """

    name: str
    title: str
    tasks: Callable[[bool], Sequence[Task]]
    parse_result: Callable[[Plain], Any]
    tables: Callable[[Sequence[Any]], Sequence[tuple[str, TextTable]]]
    verdict: Callable[[Sequence[Any]], tuple[str, bool]]
    show: Callable[[HtmlPage, Sequence[Any]], None]
    tables_at_end: bool = True


KEY_LENGTH = 24

FAILED = "failed"
"""Key of a result of a task that ended in a typed error: a failure is a result."""


def run_tasks(
    name: str, tasks: Sequence[Task], directory: Path | None, *, progress: bool = True
) -> list[Plain]:
    """Return the results of tasks, those on disk included."""
    results = []
    saved = None if directory is None else ResultCache(directory / "pieces")
    for task in _iterate_with_progress(name, tasks, progress):
        key = _task_key(name, task)
        result: Plain | None = None if saved is None else saved.read(key)
        if result is None:
            try:
                result = task.measure()
            except GranularError as stop:
                result = {FAILED: f"{type(stop).__name__}: {stop}", "label": task.label}
            if saved is not None:
                saved.keep(key, result)
        results.append(result)
    return results


def _iterate_with_progress(name: str, tasks: Sequence[Task], progress: bool) -> Iterator[Task]:
    from granular.shared.progress_bars import progress_bar

    with progress_bar(
        total=len(tasks),
        desc=name,
        wanted=progress,
        bar_format="{desc} {bar:20} {n_fmt}/{total_fmt}{postfix} [{elapsed}]",
    ) as bar:
        for task in tasks:
            bar.set_postfix_str(task.label)
            yield task
            bar.update()


def _task_key(name: str, task: Task) -> str:
    content = {"key": task.key, "part": name, "sources": source_digest(), "on": machine_info()}
    return f"{name}-{digest(content, KEY_LENGTH)}"


_SHOWING = ("report.py", "text_tables.py", "html_pages.py", "plotting.py", "published.py")
"""Files that only show what was measured, or on which no section depends."""


def scene_key(scene: Scene) -> dict[str, Any]:
    """Part of a task's key that tells a scene from others, and a user's functions in it from edited ones."""
    return {"scene": scene.digest(), "own": custom_code_digests(scene)}


@cache
def source_digest() -> str:
    """Digest (SHA-256) of all code that a figure of the report may depend on."""
    import granular
    import validation

    content = hashlib.sha256()
    for package in (granular, validation):
        assert package.__file__ is not None
        for path in sorted(Path(package.__file__).parent.rglob("*.py")):
            if path.name not in _SHOWING:
                content.update(path.read_bytes())
    return content.hexdigest()


def machine_info() -> dict[str, str]:
    """Processor, cores, system, and versions of Python and the packages computed with."""
    import os

    from granular.shared.version import versions

    here = {"processor": _processor_name(), "cores": str(os.cpu_count()), "system": platform.system()}
    return here | versions()


def _processor_name() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
