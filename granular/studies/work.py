"""What a worker does: one case, whose outcome it keeps in the study's directory."""

from __future__ import annotations

import contextlib
import warnings
from pathlib import Path
from typing import Any

from granular.shared.errors import GranularError, MissingError, StoreError
from granular.shared.files import make_directory
from granular.shared.locks import locked
from granular.shared.result_cache import ResultCache
from granular.studies.cases import Case, Measure

Outcome = dict[str, Any]
"""``figures`` of a case that succeeded, ``error`` of one that did not.

Only what the physics says stands. An outcome that is not kept has a ``cause`` besides: one of those
below.
"""

MACHINE = "machine"
"""A disk, memory or a process failed: the same case may succeed a moment later."""
PROGRAM = "program"
"""The measure or the toolkit has an error: the case fails until that is mended."""
ELSEWHERE = "elsewhere"
"""Another sweep is computing the case."""

OF_THE_MACHINE = (OSError, StoreError, MemoryError)


def outcomes_in(directory: Path) -> ResultCache:
    """The outcomes that a study's directory keeps, by the keys of their cases."""
    return ResultCache(directory / "cases")


def compute(
    case: Case, measure: Measure, directory: Path | None, keep_runs: bool, wait: bool = True
) -> Outcome:
    """The outcome of a case; one that was done before is read.

    A worker writes what it has done itself: it is not lost when the command that waits for it is.
    A case that another process computes is waited for, or told of.
    """
    try:
        if directory is None:
            return _computed(case, measure, None)
        cache = outcomes_in(directory)
        make_directory(cache.directory)
        with locked(cache.directory / f".{case.key}.lock", wait) as alone:
            if not alone:
                return failure("another sweep computes it", ELSEWHERE)
            return _kept(cache, case, measure, directory / "runs" / case.key if keep_runs else None)
    except OF_THE_MACHINE as error:
        return failure(f"{type(error).__name__}: {error}", MACHINE)
    except Exception as error:
        return failure(f"{type(error).__name__}: {error}", PROGRAM)


def failure(error: str, cause: str) -> Outcome:
    """An outcome that is not kept."""
    return {"figures": {}, "error": error, "cause": cause}


def _kept(cache: ResultCache, case: Case, measure: Measure, out: Path | None) -> Outcome:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the study has said what is damaged
        done: Outcome | None = cache.read(case.key)
    if done is None:
        done = _computed(case, measure, out)
        with contextlib.suppress(StoreError):  # the study tries it again
            cache.keep(case.key, done)
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
    except (*OF_THE_MACHINE, MissingError):
        raise
    except GranularError as error:
        return {"figures": {}, "error": f"{type(error).__name__}: {error}"}
    return {"figures": figures, "error": None}


def _plain(value: Any) -> Any:
    """A NumPy scalar as Python's own, so that JSON keeps every bit."""
    return value.item() if hasattr(value, "item") else value
