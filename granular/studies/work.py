"""What a worker does: one case, whose outcome it keeps in the study's directory."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

from granular.shared.errors import GranularError
from granular.shared.shelf import Shelf
from granular.studies.cases import Case, Measure

Outcome = dict[str, Any]
"""``figures`` of a case that succeeded, ``error`` of one that did not."""


def outcomes_in(directory: Path) -> Shelf:
    """The outcomes that a study's directory keeps, by the keys of their cases."""
    return Shelf(directory / "cases")


def compute(case: Case, measure: Measure, directory: Path | None, keep_runs: bool) -> Outcome:
    """The outcome of a case; one that was done before is read.

    A worker writes what it has done itself: it is not lost when the command that waits for it is.
    """
    if directory is None:
        return _computed(case, measure, None)
    shelf = outcomes_in(directory)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the study has said what is damaged
        done: Outcome | None = shelf.read(case.key)
    if done is None:
        done = _computed(case, measure, directory / "runs" / case.key if keep_runs else None)
        shelf.keep(case.key, done)
    return done


def _computed(case: Case, measure: Measure, out: Path | None) -> Outcome:
    from granular.run.simulation import simulate

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            run = simulate(
                case.scene, **case.settings, out=out, resume=out is not None,
                threads=1, progress=False,
            )  # fmt: skip
        figures = {name: _plain(value) for name, value in measure(run).items()}
    except GranularError as error:
        return {"figures": {}, "error": f"{type(error).__name__}: {error}"}
    return {"figures": figures, "error": None}


def _plain(value: Any) -> Any:
    """A NumPy scalar as Python's own, so that JSON keeps every bit."""
    return value.item() if hasattr(value, "item") else value
