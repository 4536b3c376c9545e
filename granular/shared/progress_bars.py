"""Progress of long work on standard error: a bar on a terminal or in a notebook, a few lines in a log."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

LINES_EVERY = 60.0
"""Minimum time between two lines in a log [s]; the first and the last are always written."""


def progress_bar(*, wanted: bool = True, **options: Any) -> Any:
    """Make a progress bar by tqdm: a widget in a notebook, a line in a terminal, a few lines in a log."""
    tqdm = _import_tqdm()
    if not wanted or sys.stderr.isatty() or "ipykernel" in sys.modules:
        return tqdm(disable=not wanted, **options)
    form = options.get("bar_format", "{desc}: {n_fmt} of {total_fmt}{postfix} [{elapsed}]")
    options["bar_format"] = form.replace(" {bar:20}", "")
    options |= {"file": _ProgressLinesInLog(), "mininterval": LINES_EVERY, "maxinterval": LINES_EVERY}
    bar = tqdm(**options)
    bar.refresh = _limit_call_rate(bar.refresh)  # called each time that a text is set
    return bar


def _limit_call_rate(function: Callable[..., Any]) -> Callable[..., None]:
    """Return a function that calls another one at most once per `LINES_EVERY` seconds."""
    last = time.monotonic()

    def call(*args: Any, **keywords: Any) -> None:
        nonlocal last
        if time.monotonic() >= last + LINES_EVERY:
            last = time.monotonic()
            function(*args, **keywords)

    return call


@contextmanager
def stage_reporter(name: str, *, wanted: bool) -> Iterator[Callable[[str], None]]:
    """Yield a function that shows a text, such as the present stage of a job, on a progress line."""
    with progress_bar(wanted=wanted, desc=name, bar_format="{desc} [{elapsed}]") as bar:
        yield lambda words: bar.set_description_str(f"{name}: {words}")


def print_above_bar(words: str) -> None:
    """Print a line on standard error, above a progress bar if there is one."""
    _import_tqdm().write(words, file=sys.stderr)


def _import_tqdm() -> Any:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="IProgress not found")  # without widgets: a plain line
        from tqdm.auto import tqdm
    return tqdm


class _ProgressLinesInLog:
    """File-like object that prints each new state of a bar on a separate line."""

    def __init__(self) -> None:
        self._last = ""

    def write(self, text: str) -> None:
        state = text.replace("\r", "").strip()
        if state and state != self._last:
            print(state, file=sys.stderr)
            self._last = state

    def flush(self) -> None:
        sys.stderr.flush()
