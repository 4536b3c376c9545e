"""Speed from commit to commit: times over the time of a reference kernel in the same run.

Machines differ, and load slows all kernels equally; the ratio to a fixed plain loop is constant. Each run
adds a line of JSON to a file, and a table shows the last lines. Entries do not pass or fail; a person judges
the table.
"""

from __future__ import annotations

import datetime
import json
import statistics
import subprocess
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.jobs import JOBS, job_times
from benchmarks.timing import minimum_seconds
from granular.shared.blocks import Table
from granular.shared.errors import InputError
from granular.shared.version import toolkit_and_library_versions

GRAINS, MANY = 368, 1472

STEPS = 64
"""Number of engine steps timed together."""

REFERENCE = "plain loop over the pairs of 368 grains"

_FITS = 3
_SHOWN = 12


class Kernel(NamedTuple):
    """A timed kernel.

    Attributes
    ----------
    call : callable
    times : int
        Number of repetitions of the timed operation per call.
    """

    call: Callable[[], Any]
    times: int = 1


def _kernels() -> dict[str, Kernel]:
    from benchmarks.engine import bed_of
    from benchmarks.sums import BATCH, PaddedGrains, arrangement, by_cut_off, direct, plain
    from validation.overview import EngineSteps

    def step(count: int, changes: dict[str, Any]) -> Kernel:
        engine = EngineSteps(bed_of(count, changes))
        return Kernel(lambda: engine.make_steps(STEPS), STEPS)

    grains = PaddedGrains(arrangement(GRAINS))
    friction: dict[str, Any] = {"effects.drag": None, "effects.friction": {}}
    return {
        REFERENCE: Kernel(plain(grains).call),
        "direct sum": Kernel(direct(grains).call),
        "direct sum, load": Kernel(direct(grains, load=True).call),
        "cut-off, 1472": Kernel(by_cut_off(arrangement(MANY)).call, BATCH),
        "step, drag": step(GRAINS, {}),
        "step, friction": step(GRAINS, friction),
        "step, mesh, 1472": step(MANY, {"pairs.method": "mesh"}),
    }


def measured(rounds: int = 40, jobs: Sequence[str] = tuple(JOBS)) -> dict[str, Any]:
    """Return one entry: time of the reference [s], and the ratios of all other times to it."""
    from benchmarks.fits import measured_here

    kernels = _kernels()
    calls = {name: kernel.call for name, kernel in kernels.items()}
    result = minimum_seconds(calls, rounds=rounds, seconds=0.002)
    seconds = {name: time / kernels[name].times for name, time in result.items()}
    seconds["fit, linear law"] = min(measured_here("linear", 1000, _FITS)["warm"])
    seconds |= {f"{row['job']}, processor": row["processor"] for row in job_times(jobs)}
    reference = seconds.pop(REFERENCE)
    return {
        **_commit(),
        "date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M"),
        "versions": toolkit_and_library_versions(),
        "reference": {"what": REFERENCE, "seconds": reference},
        "ratios": {name: time / reference for name, time in seconds.items()},
    }


def _commit() -> dict[str, Any]:
    """Return the commit of the sources, and True if files differ from it; empty without git."""
    here = Path(__file__).parent

    def git(*words: str) -> str | None:
        try:
            done = subprocess.run(
                ["git", "-C", str(here), *words], capture_output=True, text=True, check=True
            )
        except (OSError, subprocess.CalledProcessError):
            return None
        return done.stdout.strip()

    commit, changed = git("rev-parse", "--short=10", "HEAD"), git("status", "--porcelain")
    return {"commit": commit, "changed": bool(changed)}


def read(path: Path) -> list[dict[str, Any]]:
    """Return the entries of a file, oldest first; empty if there is no file.

    Raises
    ------
    InputError
        If a line is not an entry.
    """
    if not path.exists():
        return []
    entries: list[dict[str, Any]] = []
    try:
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            entries.append(_entry(line, f"{path}, line {number}"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} cannot be read: {error}; give another file") from None
    return entries


def _entry(line: str, source: str) -> dict[str, Any]:
    try:
        result = json.loads(line)
        ratios = {str(name): float(value) for name, value in result["ratios"].items()}
        return {"commit": None, "changed": False, "date": ""} | result | {"ratios": ratios}
    except (ValueError, TypeError, KeyError, AttributeError):
        raise InputError(f"{source} is not an entry of a history; remove it") from None


def add(path: Path, entry: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Add an entry to the file, and return all entries.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    entries = [*read(path), dict(entry)]
    try:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}; give another file") from None
    return entries


def history_table(entries: Sequence[Mapping[str, Any]]) -> Table:
    """Return the table of the last entries, and of the newest over the median of the earlier ones shown."""
    shown = entries[-_SHOWN:]
    names = list(dict.fromkeys(name for item in shown for name in item["ratios"]))
    rows = [
        [
            item["date"],
            f"{item['commit'] or '?'}{'+' if item['changed'] else ''}",
            *(_number(item["ratios"].get(name)) for name in names),
        ]
        for item in shown
    ]
    if len(shown) > 1:
        rows.append(["newest over the median before", "", *(_trend(shown, item) for item in names)])
    return Table(["date (UTC)", "commit", *names], rows)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


def _trend(entries: Sequence[Mapping[str, Any]], name: str) -> str:
    *before, newest = [item["ratios"].get(name) for item in entries]
    known = [value for value in before if value is not None]
    return f"{newest / statistics.median(known):.2f}" if known and newest is not None else ""
