"""Do the tests bite? Plant faults, drawn by a seed, one at a time, and see whether a test fails.

    python tests/mutation/survey.py --list                      what would be planted
    python tests/mutation/survey.py -o mutation.json            all of them; again: goes on
    python tests/mutation/survey.py -o mutation.json --again    survivors once more, with new tests

Each fault goes into a temporary copy of the tree, where the quick tests that cover the file are run
until one fails. A run that takes many times as long as without a fault counts as caught too: the
fault makes it go on for ever. Seconds are those of the processor, whatever else it has to do. What
is finished is in the file; Ctrl-C loses the fault at work only.
Exit code: 0, or 1 with survivors.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple

from covering import FULL, Stage, stages
from faults import AREAS, Fault, drawn

ROOT = Path(__file__).parents[2]

PARTS = (
    ".ci",
    ".github",
    "docs",
    "granular",
    "notebooks",
    "reduced_models",
    "research",
    "tests",
    "validation",
)

KERNELS = (b"@compiled", b"@entry", b"@intrinsic", b"llvmlite")
"""Marks of files whose change makes every compiled function of the package stale."""

PATIENCE = 3.0
"""How many times as long as without a fault tests may take."""
ASLEEP = 20.0
"""And how many times that on the clock: what waits for ever takes no time of the processor."""


class Outcome(NamedTuple):
    """What became of a fault.

    Attributes
    ----------
    caught : bool
    by : str
        The test that failed, or what else happened.
    seconds : float
    """

    caught: bool
    by: str
    seconds: float


class Place(NamedTuple):
    """Where faults are planted: a copy of the tree, and a store of its compiled code."""

    tree: Path
    store: Path


def main() -> int:
    options = _options()
    faults = drawn(ROOT, options.seed, options.count)
    if options.list:
        print("\n".join(f"{number:3} {fault}" for number, fault in enumerate(faults, start=1)))
        return 0
    book = Book(Path(options.out), options.seed, options.count)
    try:
        with workplace() as place:
            for number, fault in enumerate(faults, start=1):
                if _wanted(number, book, options):
                    print(f"{number:3} {fault}", flush=True)
                    outcome = tried(fault, place, book, integer=options.integer)
                    book.note(number, fault, outcome)
                    word = f"caught by {outcome.by}" if outcome.caught else "SURVIVED"
                    print(f"    {word} ({outcome.seconds:.0f} s)", flush=True)
    except KeyboardInterrupt:
        print(f"interrupted; {options.out} keeps what is finished, and the same command goes on")
    return _summary(book, faults)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("-o", "--out", metavar="FILE", default="mutation.json")
    parser.add_argument("--only", type=int, nargs="+", metavar="N", help="these numbers only")
    parser.add_argument("--again", action="store_true", help="try survivors again")
    parser.add_argument("--whole", action="store_true", help="then all quick tests on what survives its own")
    parser.add_argument("--list", action="store_true", help="show the faults, and plant none")
    return parser.parse_args()


def _wanted(number: int, book: Book, options: argparse.Namespace) -> bool:
    if options.only and number not in options.only:
        return False
    known = book.outcome(number)
    return known is None or (options.again and not known.caught)


class Book:
    """Outcomes by number, kept in a file that is whole at any moment."""

    def __init__(self, path: Path, seed: int, count: int) -> None:
        self.path = path
        what = {"seed": seed, "count": count, "sources": _digest()}
        self.content: dict[str, Any] = {**what, "sound": {}, "faults": {}}
        if path.exists():
            former = json.loads(path.read_text(encoding="utf-8"))
            if {key: former[key] for key in what} != what:
                raise SystemExit(f"{path} is of another seed or count, or of other sources; give another -o")
            self.content = former

    def outcome(self, number: int) -> Outcome | None:
        known = self.content["faults"].get(str(number))
        return known and Outcome(known["caught"], known["by"], known["seconds"])

    def note(self, number: int, fault: Fault, outcome: Outcome) -> None:
        self.content["faults"][str(number)] = {"fault": str(fault), **outcome._asdict()}
        self._save()

    def sound(self, stage: Stage) -> float | None:
        """Seconds in which the tests pass where there is no fault; None where that is not known."""
        seconds: float | None = self.content["sound"].get(_key(stage))
        return seconds

    def note_sound(self, stage: Stage, seconds: float) -> None:
        self.content["sound"][_key(stage)] = seconds
        self._save()

    def _save(self) -> None:
        part = self.path.with_suffix(".part")
        part.write_text(json.dumps(self.content, indent=1) + "\n", encoding="utf-8")
        part.replace(self.path)


def _key(stage: Stage) -> str:
    return f"{'compiled' if stage.compiled else 'plain'}: {' '.join(stage.paths)}"


def _digest() -> str:
    """Of the files that faults are drawn from: other sources, other faults."""
    digest = hashlib.sha256()
    for folder in (folder for folders in AREAS.values() for folder in folders):
        for path in sorted((ROOT / folder).rglob("*.py")):
            digest.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:16]


@contextlib.contextmanager
def workplace() -> Iterator[Place]:
    with tempfile.TemporaryDirectory() as folder:
        place = Place(Path(folder, "tree"), Path(folder, "store"))
        place.tree.mkdir()
        litter = shutil.ignore_patterns("__pycache__", ".*_cache", ".ipynb_checkpoints")
        for name in PARTS:
            shutil.copytree(ROOT / name, place.tree / name, ignore=litter)
        for path in ROOT.iterdir():
            if path.suffix in (".md", ".toml", ".yml", ".cff"):
                shutil.copy2(path, place.tree / path.name)
        yield place


def tried(fault: Fault, place: Place, book: Book, *, integer: bool) -> Outcome:
    """Plant a fault, run the tests that cover its file, and take it out again."""
    path = place.tree / fault.path
    source = path.read_text(encoding="utf-8")
    started, outcome = _processor_seconds(), Outcome(False, "", 0.0)
    for stage in (*stages(fault.path), *((FULL,) if integer else ())):
        limit = PATIENCE * _sound_seconds(stage, place, book) + 60.0
        try:
            path.write_text(fault.planted(source), encoding="utf-8")
            outcome = _run_with_fault(stage, place, path, limit)
        finally:
            path.write_text(source, encoding="utf-8")
        if outcome.caught:
            break
    return outcome._replace(seconds=_processor_seconds() - started)


def _sound_seconds(stage: Stage, place: Place, book: Book) -> float:
    """How long the tests take without a fault, all compiling included.

    Tests that fail anyway would prove nothing: the survey ends there.
    """
    known = book.sound(stage)
    if known is not None:
        return known
    started = _processor_seconds()
    with tempfile.TemporaryDirectory() as store:
        outcome = _run(stage, place.tree, store, None)
        shutil.copytree(store, place.store, dirs_exist_ok=True)
    if outcome.caught:
        raise SystemExit(f"without a fault {outcome.by} fails ({_key(stage)}); correct that first")
    seconds = _processor_seconds() - started
    book.note_sound(stage, seconds)
    return seconds


def _run_with_fault(stage: Stage, place: Place, path: Path, limit: float) -> Outcome:
    # A fault in a kernel makes all compiled code stale: it gets a store of its own, so that the
    # next fault still finds that of the sound tree.
    if any(mark in path.read_bytes() for mark in KERNELS):
        with tempfile.TemporaryDirectory() as store:
            return _run(stage, place.tree, store, limit)
    return _run(stage, place.tree, str(place.store), limit)


def _processor_seconds() -> float:
    """Of all processes that were started here and have ended."""
    times = os.times()
    return times.children_user + times.children_system


_FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)


def _run(stage: Stage, tree: Path, store: str, limit: float | None) -> Outcome:
    """Run tests until one fails."""
    environment = os.environ | {
        "NUMBA_CACHE_DIR": store,
        "NUMBA_DISABLE_JIT": "0" if stage.compiled else "1",
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", *stage.paths]
    with tempfile.TemporaryFile("w+") as said:
        code = _finished(command, tree, environment, limit, said)
        said.seek(0)
        failed = _FAILED.search(said.read())
    if code == 0:
        return Outcome(False, "", 0.0)
    if code is None:
        return Outcome(True, f"the limit of {limit:.0f} s", 0.0)
    return Outcome(True, failed[1] if failed else f"pytest's exit code {code}", 0.0)


def _finished(
    command: list[str], tree: Path, environment: dict[str, str], limit: float | None, said: IO[str]
) -> int | None:
    """Exit code of a command; None, and all its children ended, where it takes too long."""
    if limit is not None:
        command = ["sh", "-c", 'ulimit -t "$0" && exec "$@"', str(int(limit)), *command]
    child = subprocess.Popen(
        command, cwd=tree, env=environment, stdout=said, stderr=subprocess.STDOUT, start_new_session=True
    )
    try:
        code = child.wait(None if limit is None else ASLEEP * limit)
        return None if code in (-signal.SIGXCPU, -signal.SIGKILL) else code
    except subprocess.TimeoutExpired:
        return None
    finally:
        if child.poll() is None:
            os.killpg(child.pid, signal.SIGKILL)
            child.wait()


def _summary(book: Book, faults: list[Fault]) -> int:
    known = {number: book.outcome(number) for number in range(1, len(faults) + 1)}
    done = {number: one for number, one in known.items() if one is not None}
    caught = sum(one.caught for one in done.values())
    print(f"{caught} caught of {len(done)} tried of {len(faults)} drawn (seed and all in {book.path})")
    survivors = [number for number, one in done.items() if not one.caught]
    for number in survivors:
        print(f"survived: {number:3} {faults[number - 1]}")
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
