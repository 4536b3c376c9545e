"""Write the page of all files with their first docstring lines: ``python docs/files.py``."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "reference" / "files.md"
PACKAGES = ("granular", "reduced_models", "validation", "research", "benchmarks")


def first_line(path: Path) -> str:
    """First line of the docstring of a file."""
    return (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").partition("\n")[0]


def page_of_files() -> str:
    """Text of the page, grouped by directory."""
    lines = [
        "# Which file is about what?",
        "",
        "Written by `python docs/files.py` from the files' first lines.",
        "",
    ]
    for package in PACKAGES:
        for room in sorted({path.parent for path in (ROOT / package).rglob("*.py")}):
            files = sorted(path for path in room.glob("*.py") if not path.name.startswith("__"))
            if not files:
                continue
            about = first_line(room / "__init__.py") if (room / "__init__.py").is_file() else ""
            lines += [f"## {room.relative_to(ROOT)}/", "", about, "", "| file | about |", "|---|---|"]
            lines += [f"| `{path.name}` | {first_line(path)} |".replace("||", "| |") for path in files]
            lines += [""]
    return "\n".join(lines)


if __name__ == "__main__":
    PAGE.write_text(page_of_files(), encoding="utf-8")
