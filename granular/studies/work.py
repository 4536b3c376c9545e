"""What a worker does: one case, whose outcome it keeps in the study's directory."""

from __future__ import annotations

import json
import os
import warnings
from pathlib import Path
from typing import Any

from granular.shared.errors import GranularError, StoreError
from granular.studies.cases import Case, Measure

Outcome = dict[str, Any]
"""``figures`` of a case that succeeded, ``error`` of one that did not."""


def outcome_path(directory: Path, key: str) -> Path:
    return directory / "cases" / f"{key}.json"


def read_outcome(directory: Path, key: str) -> Outcome | None:
    """What is kept of a case, if it was done.

    Raises
    ------
    StoreError
        If the file is not what a study wrote.
    """
    path = outcome_path(directory, key)
    try:
        outcome = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise StoreError(f"{path} cannot be read ({error}); remove it to compute it anew") from None
    return dict(outcome)


def keep_outcome(directory: Path, key: str, outcome: Outcome) -> None:
    """Write an outcome, in one step."""
    path = outcome_path(directory, key)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{key}.{os.getpid()}.part")
    part.write_text(json.dumps(outcome), encoding="utf-8")
    os.replace(part, path)


def compute(case: Case, measure: Measure, directory: Path | None, keep_runs: bool) -> Outcome:
    """The outcome of a case; one that was done before is read.

    A worker writes what it has done itself: it is not lost when the command that waits for it is.
    """
    from granular.run.simulation import simulate

    if directory is not None:
        done = read_outcome(directory, case.key)
        if done is not None:
            return done
    out = None if directory is None or not keep_runs else directory / "runs" / case.key
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            run = simulate(
                case.scene, **case.settings, out=out, resume=out is not None,
                threads=1, progress=False,
            )  # fmt: skip
        figures = {name: _plain(value) for name, value in measure(run).items()}
        outcome: Outcome = {"figures": figures, "error": None}
    except GranularError as error:
        outcome = {"figures": {}, "error": f"{type(error).__name__}: {error}"}
    if directory is not None:
        keep_outcome(directory, case.key, outcome)
    return outcome


def _plain(value: Any) -> Any:
    """A NumPy scalar as Python's own, so that JSON keeps every bit."""
    return value.item() if hasattr(value, "item") else value
