"""No file contains paths or tools of one particular computer, or reads files outside the repository."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TEXT = {".py", ".pyi", ".md", ".toml", ".yml", ".yaml", ".cff", ".cfg", ".ipynb", ".json", ".txt"}
SKIPPED = {".git", "out", "build", "dist"}

PLACES = re.compile(
    r"(?<![\w./:~-])/(?:home|root|Users|work|mnt|srv|opt|tmp|var/folders)/[\w.-]"  # absolute paths
    r"|[A-Z]:\\\\?Users"
    r"|\bhttps?://(?:localhost|127\.0\.0\.1|10\.|192\.168\.)"
)


def text_files() -> list[Path]:
    found = []
    for path in ROOT.rglob("*"):
        parts = path.relative_to(ROOT).parts
        hidden = any(part.startswith(".") and part not in {".ci", ".github"} for part in parts)
        if hidden or SKIPPED & set(parts) or "__pycache__" in parts or not path.is_file():
            continue
        if path.suffix in TEXT or parts[0] == ".ci":
            found.append(path)
    return found


def places_in(text: str) -> list[str]:
    return [match.group() for match in PLACES.finditer(text)]


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ('open("/home/ada/run")', True),
        ("cd /" + "root/.cache", True),
        ("C:\\Users\\ada", True),
        ("http://localhost:8000", True),
        ("runs/home/bed", False),
        ("https://example.org/home/page", False),
        ("z''/work per cycle", False),
    ],
)
def test_paths_of_one_particular_computer_are_detected(text: str, named: bool) -> None:
    assert bool(places_in(text)) == named


def test_no_file_contains_a_path_of_one_particular_computer() -> None:
    files = text_files()
    assert len(files) > 300
    found = {}
    for path in files:
        if path == Path(__file__):
            continue
        places = places_in(path.read_text(encoding="utf-8", errors="replace"))
        if places:
            found[str(path.relative_to(ROOT))] = places[:3]
    assert not found


def test_no_file_refers_to_a_folder_above_the_repository() -> None:
    """For a file k folders deep, ``Path(__file__).parents[k]`` is the repository's root.

    A larger index is above the root.
    """
    above = {}
    for path in text_files():
        if path.suffix != ".py":
            continue
        depth = len(path.relative_to(ROOT).parts)
        climbs = re.findall(r"__file__\)(?:\.resolve\(\))?\.parents\[(\d+)\]", path.read_text("utf-8"))
        if any(int(climb) >= depth for climb in climbs):
            above[str(path.relative_to(ROOT))] = climbs
    assert not above
