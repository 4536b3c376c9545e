"""Mutation survey: plant random faults, one at a time, and check that a test fails.

    python tests/mutation/survey.py --list                      the faults to be planted
    python tests/mutation/survey.py -o mutation.json            all of them; repeated: resumes
    python tests/mutation/survey.py -o mutation.json --again    survivors once more, with new tests

Each fault is planted in a temporary copy of the tree, in which the quick tests that cover the file are run
until one fails, or until they take many times as long as without a fault. Exit code: 0, or 1 with survivors.
"""

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
import time
from collections.abc import Iterator
from pathlib import Path

from covering import FULL, Stage, stages
from faults import AREAS, Fault, drawn

ROOT = Path(__file__).parents[2]
PARTS = [
    ".ci",
    ".github",
    "docs",
    "granular",
    "notebooks",
    "reduced_models",
    "research",
    "tests",
    "validation",
]
KERNELS = (b"@compiled", b"@entry", b"@intrinsic", b"llvmlite")
"""Patterns of files whose change makes every compiled function of the package stale."""
PATIENCE = 5.0
"""Maximum time of tests, over their time without a fault."""
FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)


def main() -> int:
    options = _options()
    faults = drawn(ROOT, options.seed, options.count)
    if options.list:
        print("\n".join(f"{number:3} {fault}" for number, fault in enumerate(faults, start=1)))
        return 0
    path = Path(options.out)
    what = {"seed": options.seed, "count": options.count, "sources": _digest()}
    book = json.loads(path.read_text("utf-8")) if path.exists() else what | {"sound": {}, "caught": {}}
    if {key: book[key] for key in what} != what:
        raise SystemExit(f"{path} is of another seed or count, or of other sources; give another -o")
    with contextlib.suppress(KeyboardInterrupt), workplace() as (tree, store):
        for number, fault in enumerate(faults, start=1):
            known = book["caught"].get(str(number))
            if (options.only and number not in options.only) or known or (known == "" and not options.again):
                continue
            print(f"{number:3} {fault}", flush=True)
            more = (FULL,) if options.whole else ()
            book["caught"][str(number)] = by = caught_by(fault, tree, store, book["sound"], more)
            print(f"    caught by {by}" if by else "    SURVIVED", flush=True)
            part = path.with_suffix(".part")
            part.write_text(json.dumps(book, indent=1) + "\n", encoding="utf-8")
            part.replace(path)
    survivors = [int(number) for number, by in book["caught"].items() if not by]
    tried = len(book["caught"])
    print(f"{tried - len(survivors)} caught of {tried} tried of {len(faults)} drawn (all in {path})")
    for number in survivors:
        print(f"survived: {number:3} {faults[number - 1]}")
    return 1 if survivors else 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("-o", "--out", metavar="FILE", default="mutation.json")
    parser.add_argument(
        "--only", type=int, nargs="+", metavar="N", help="run only the faults with these numbers"
    )
    parser.add_argument("--again", action="store_true", help="try survivors again")
    parser.add_argument("--whole", action="store_true", help="then run all quick tests on surviving faults")
    parser.add_argument("--list", action="store_true", help="show the faults without planting them")
    return parser.parse_args()


def _digest() -> str:
    """Return a digest of the files from which faults are drawn."""
    digest = hashlib.sha256()
    for folder in (folder for folders in AREAS.values() for folder in folders):
        for path in sorted((ROOT / folder).rglob("*.py")):
            digest.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:16]


@contextlib.contextmanager
def workplace() -> Iterator[tuple[Path, Path]]:
    """Make a copy of the tree, and a cache of its compiled code."""
    with tempfile.TemporaryDirectory() as folder:
        tree, store = Path(folder, "tree"), Path(folder, "store")
        tree.mkdir()
        litter = shutil.ignore_patterns("__pycache__", ".*_cache", ".ipynb_checkpoints")
        for name in PARTS:
            shutil.copytree(ROOT / name, tree / name, ignore=litter)
        for path in ROOT.iterdir():
            if path.suffix in (".md", ".toml", ".yml", ".cff"):
                shutil.copy2(path, tree / path.name)
        yield tree, store


def caught_by(fault: Fault, tree: Path, store: Path, sound: dict[str, float], more: tuple[Stage, ...]) -> str:
    """Plant a fault, run the tests that cover its file, remove it, and return the failing test or ''."""
    path = tree / fault.path
    source = path.read_text(encoding="utf-8")
    # A fault in a kernel makes all compiled code stale, so it gets a separate cache.
    kernel = any(mark in path.read_bytes() for mark in KERNELS)
    for stage in (*stages(fault.path), *more):
        key = f"{'compiled' if stage.compiled else 'plain'}: {' '.join(stage.paths)}"
        if key not in sound:
            started = time.monotonic()
            if failed := _run(stage, tree, store, None):
                raise SystemExit(f"without a fault {failed} fails ({key}); correct that first")
            sound[key] = time.monotonic() - started
        path.write_text(fault.planted(source), encoding="utf-8")
        try:
            with tempfile.TemporaryDirectory() as apart:
                by = _run(stage, tree, Path(apart) if kernel else store, PATIENCE * sound[key] + 300.0)
        finally:
            path.write_text(source, encoding="utf-8")
        if by:
            return by
    return ""


def _run(stage: Stage, tree: Path, store: Path, limit: float | None) -> str:
    """Run tests until one fails, and return its name or another cause of failure."""
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(store),
        "NUMBA_DISABLE_JIT": "0" if stage.compiled else "1",
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", *stage.paths]
    child = subprocess.Popen(
        command, cwd=tree, env=environment, stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        said, _ = child.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        return f"the limit of {limit:.0f} s"
    finally:
        if child.poll() is None:
            os.killpg(child.pid, signal.SIGKILL)
            child.wait()
    failed = FAILED.search(said)
    return "" if child.returncode == 0 else failed[1] if failed else f"pytest's exit code {child.returncode}"


if __name__ == "__main__":
    sys.exit(main())
