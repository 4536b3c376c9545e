"""Size of the package as a wheel, and time of imports."""

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
"""Folders that are not in a wheel."""

IMPORTS = (
    "pass",
    *(f"import {name}" for name in PACKAGES),
    "from granular import load_scene",
    "from granular import simulate",
    "from reduced_models import fit",
    "from validation.console_script import dispatch_command",
)
"""Statements, each timed in separate processes; the first is the start of Python."""


def package_figures(rounds: int = 5) -> list[dict[str, Any]]:
    """Return the size [bytes], and the minimum time [s] of each import minus the start of Python."""
    rows: list[dict[str, Any]] = [{"what": "the wheel", "bytes": packed_size()}]
    times = {item: min(_seconds(item) for _ in range(rounds)) for item in IMPORTS}
    start = times["pass"]
    rows.append({"what": "start of Python", "seconds": start})
    return rows + [
        {"what": item, "seconds": seconds - start} for item, seconds in times.items() if item != "pass"
    ]


def packed_size() -> int:
    """Return the bytes of the packages' files in a ZIP archive, the format of a wheel."""
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
