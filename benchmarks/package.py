"""What the package weighs: its size as a wheel packs it, and how long imports take."""

from __future__ import annotations

import importlib.util
import io
import sys
import time
import zipfile
from pathlib import Path
from typing import Any

from benchmarks.process import finished

PACKAGES = ("granular", "reduced_models", "validation")

LEFT_OUT = ("__pycache__",)
"""Folders that a wheel does not hold."""

IMPORTS = (
    "pass",
    *(f"import {name}" for name in PACKAGES),
    "from granular import load_scene",
    "from granular import simulate",
    "from reduced_models import fit",
    "from validation.console_script import dispatch_command",
)
"""Statements, each timed in processes of its own; the first is Python's own start."""


def package_figures(rounds: int = 5) -> list[dict[str, Any]]:
    """Size [bytes], and least time [s] of each import, the start of Python taken off."""
    rows: list[dict[str, Any]] = [{"what": "the wheel", "bytes": packed_size()}]
    times = {item: min(_seconds(item) for _ in range(rounds)) for item in IMPORTS}
    start = times["pass"]
    rows.append({"what": "start of Python", "seconds": start})
    return rows + [
        {"what": item, "seconds": seconds - start} for item, seconds in times.items() if item != "pass"
    ]


def packed_size() -> int:
    """Bytes of the packages' files in a ZIP archive, which is what a wheel is."""
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for package in PACKAGES:
            spec = importlib.util.find_spec(package)
            assert spec is not None
            assert spec.origin is not None
            folder = Path(spec.origin).parent
            for path in sorted(folder.rglob("*")):
                inside = path.relative_to(folder.parent)
                if path.is_file() and not set(inside.parts) & set(LEFT_OUT):
                    archive.write(path, inside)
    return len(target.getvalue())


def _seconds(statement: str) -> float:
    started = time.perf_counter()
    finished([sys.executable, "-c", statement])
    return time.perf_counter() - started
