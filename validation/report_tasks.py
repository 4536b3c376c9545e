"""Sections of the report: their tasks, the cache of their results, and their presentation.

A cached result is identified by the digest of its measurement, settings, sources and versions. An interrupted
report therefore resumes at its last result, and no outdated result is shown.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
import platform
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self, get_args, get_type_hints

from granular.run.summary import custom_code_digests
from granular.shared.blocks import Picture
from granular.shared.errors import GranularError
from granular.shared.files import ResultCache, digest
from granular.shared.plotting import figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from granular.scene.scene import Scene
    from granular.shared.blocks import Block

__all__ = ["Section", "Task"]

Plain = dict[str, Any]


class PlainData:
    """Base class of results, which are frozen dataclasses that can be stored as JSON."""

    def to_plain(self) -> Plain:
        """Return the result as plain data; NaN and infinity become None.

        Returns
        -------
        dict of str to Any
            Fields by name, nested ones too.
        """
        plain: Plain = to_plain(self)
        return plain

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> Self:
        """Return the result from plain data made by `to_plain`, possibly read from JSON.

        Parameters
        ----------
        plain : mapping of str to Any
            Fields by name.

        Returns
        -------
        Self
            The result; None in place of a number becomes NaN.
        """
        result: Self = from_plain(cls, plain)
        return result


def to_plain(value: Any) -> Any:
    """Return dataclasses and tuples as plain data; NaN and infinity become None."""
    if dataclasses.is_dataclass(value):
        return {entry.name: to_plain(getattr(value, entry.name)) for entry in dataclasses.fields(value)}
    if hasattr(value, "_asdict"):
        return {name: to_plain(entry) for name, entry in value._asdict().items()}
    if isinstance(value, tuple):
        return [to_plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def from_plain(kind: Any, value: Any) -> Any:
    """Return a value of a given type from plain data; None in place of a number becomes NaN."""
    if value is None:
        return math.nan if kind is float else None
    if isinstance(value, list):
        first = get_args(kind)[0]
        return tuple(from_plain(first, entry) for entry in value)
    kinds = (kind, *get_args(kind))
    records = [entry for entry in kinds if dataclasses.is_dataclass(entry) or hasattr(entry, "_fields")]
    if isinstance(value, Mapping) and records:
        hints = get_type_hints(records[0])
        return records[0](**{name: from_plain(hints[name], entry) for name, entry in value.items()})
    return value


class Task(NamedTuple):
    """One measurement.

    Attributes
    ----------
    label : str
        Name for progress bars and failures.
    key : dict of str to Any
        Plain data of everything that the result depends on; it is the key of the cached result.
    measure : function
        Function that makes the measurement and returns a result of the section's type.
    """

    label: str
    key: Plain
    measure: Callable[[], Any]


@dataclasses.dataclass(frozen=True)
class Outcome:
    """A measured task: its result, or the typed error that ended it."""

    label: str
    result: Any = None
    failed: str | None = None

    def to_plain(self) -> Plain:
        """Return the result's fields, or the error under `FAILED`."""
        if self.failed is not None:
            return {FAILED: self.failed, "label": self.label}
        plain: Plain = to_plain(self.result)
        return plain

    @classmethod
    def from_plain(cls, label: str, kind: Any, plain: Plain) -> Outcome:
        """Return the outcome, with a result of the given type, from data made by `to_plain`."""
        if FAILED in plain:
            return cls(plain["label"], failed=plain[FAILED])
        return cls(label, from_plain(kind, plain))


class Section(NamedTuple):
    """A section of the report.

    Attributes
    ----------
    name : str
    title : str
        Heading; empty if the blocks of the section hold headings.
    tasks : callable
        Makes the tasks; its argument is True for the full report.
    kind : type
        Type of the results, a dataclass.
    verdict : callable
        Returns a sentence on the results, and True if they pass.
    blocks : callable
        Makes texts, tables and plots of the results.
    details : callable
        Makes the detailed tables at the end of the page.
    """

    name: str
    title: str
    tasks: Callable[[bool], Sequence[Task]]
    kind: type
    verdict: Callable[[Sequence[Any]], tuple[str, bool]]
    blocks: Callable[[Sequence[Any]], Iterable[Block]]
    details: Callable[[Sequence[Any]], Sequence[Block]] = lambda _: ()


KEY_LENGTH = 24

FAILED = "failed"
"""Key of the error in the plain data of a failed task."""


def run_tasks(
    name: str, tasks: Sequence[Task], directory: Path | None, kind: Any = dict, *, progress: bool = True
) -> list[Outcome]:
    """Return the outcomes of tasks, some of them from the cache; ``kind`` is the type of their results."""
    from granular.shared.progress_bars import progress_bar

    saved = None if directory is None else ResultCache(directory / "pieces")
    outcomes = []
    form = "{desc} {bar:20} {n_fmt}/{total_fmt}{postfix} [{elapsed}]"
    with progress_bar(total=len(tasks), desc=name, wanted=progress, bar_format=form) as bar:
        for task in tasks:
            bar.set_postfix_str(task.label)
            outcomes.append(_run_task(name, task, saved, kind))
            bar.update()
    return outcomes


def _run_task(name: str, task: Task, saved: ResultCache | None, kind: Any) -> Outcome:
    content = {"key": task.key, "part": name, "sources": source_digest(), "on": machine_info()}
    key = f"{name}-{digest(content, KEY_LENGTH)}"
    plain = None if saved is None else saved.read(key)
    if plain is not None:
        return Outcome.from_plain(task.label, kind, plain)
    try:
        outcome = Outcome(task.label, task.measure())
    except GranularError as stop:
        outcome = Outcome(task.label, failed=f"{type(stop).__name__}: {stop}")
    if saved is not None:
        saved.store(key, outcome.to_plain())
    return outcome


def successful_results(outcomes: Iterable[Outcome]) -> list[Any]:
    """Return the results of the outcomes that did not fail."""
    return [outcome.result for outcome in outcomes if outcome.failed is None]


def failure_lines(outcomes: Iterable[Outcome]) -> list[str]:
    """Return one line for each failed outcome."""
    return [f"{outcome.label} failed: {outcome.failed}" for outcome in outcomes if outcome.failed is not None]


WIDTH = 5.6
"""Width of a figure [inch]: narrow enough for legible letters on a phone."""


def label_horizontal_line(axes: Axes, words: str, height: float, **options: Any) -> None:
    """Write words above the right end of a horizontal line."""
    axes.annotate(
        words,
        (0.99, height),
        xycoords=("axes fraction", "data"),
        xytext=(0, 3),
        textcoords="offset points",
        ha="right",
        fontsize=8,
        **options,
    )


def make_one_axes_picture(
    draw: Callable[[Axes], object], caption: str, height: float = 5.0, columns: int = 2
) -> Picture:
    """Make a picture with one pair of axes and the legend below; ``height`` is in inches."""

    def make() -> Figure:
        with figure(width=WIDTH, height=height) as (drawing, axes):
            draw(axes)
            # Below the axes, so that the axes keep their width on a narrow page.
            axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=columns)
        shown: Figure = drawing
        return shown

    return Picture(make, caption)


_SHOWING = ("report.py", "blocks.py", "plotting.py")
"""Files that are not part of the digest, since results do not depend on them."""


def scene_key(scene: Scene) -> dict[str, Any]:
    """Return a scene as part of a task's key, including digests of the user's functions in the scene."""
    return {"scene": scene.digest(), "own": custom_code_digests(scene)}


@cache
def source_digest() -> str:
    """Return the digest (SHA-256) of all code that a result in the report may depend on."""
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
    """Return processor, cores, system, and versions of Python and of the packages used."""
    import os

    from granular.shared.version import toolkit_and_library_versions

    here = {"processor": _processor_name(), "cores": str(os.cpu_count()), "system": platform.system()}
    return here | toolkit_and_library_versions()


def _processor_name() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
