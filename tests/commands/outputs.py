"""Run the Python blocks of README and guide, and compare or write the outputs below them.

``python -m tests.commands.outputs [PAGE ...]`` runs the blocks of each page in a separate process and folder,
and writes their outputs below the blocks.
"""

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from .material import prepared_for_blocks
from .shown import PAGES, ROOT

MOST = 14
"""Lines of an output that a page shows."""
BETWEEN = "=== next block ==="
BLOCK = re.compile(r"```python\n(?P<code>.*?)```\n(?:\n```text\n(?P<shown>.*?)```\n)?", re.DOTALL)
FILE = re.compile(r"# [\w-]+\.py\n")
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
SECONDS = 1200.0


def with_blocks() -> list[Path]:
    """Return the pages that have Python blocks to run."""
    return [path for path in PAGES if codes(path.read_text(encoding="utf-8"))]


def codes(page: str) -> list[str]:
    """Return a page's code blocks to run. Blocks that show the content of a file are excluded."""
    return [one["code"] for one in BLOCK.finditer(page) if not FILE.match(one["code"])]


def shown(page: str) -> list[str]:
    """Return the output shown below each block, or an empty string for a block without one."""
    found = [one for one in BLOCK.finditer(page) if not FILE.match(one["code"])]
    return [one["shown"] or "" for one in found]


def printed(page: str, folder: Path) -> list[str]:
    """Run a page's blocks in order in the folder, and return the output of each."""
    script = folder / "page.py"
    parts = [f"{code}\nprint({BETWEEN!r}, flush=True)\n" for code in codes(page)]
    guard = 'if __name__ == "__main__":\n'  # sweeps start processes, which import the script
    body = "".join(f"    {line}\n" if line else "\n" for line in "\n".join(parts).splitlines())
    script.write_text(guard + body, encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join((str(ROOT), str(folder)))}
    done = subprocess.run(
        [sys.executable, script.name],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=SECONDS,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return [one.strip("\n") for one in done.stdout.split(f"{BETWEEN}\n")[:-1]]


def shortened(text: str) -> str:
    """Return the first lines of an output, without trailing spaces."""
    lines = [line.rstrip() for line in text.splitlines()]
    return "\n".join([*lines[:MOST], "..."] if len(lines) > MOST + 1 else lines)


def assert_agrees(output: str, shown: str) -> None:
    """Assert that an output has the words shown on a page, and numbers within 5 % of the shown numbers."""
    ours, theirs = output.splitlines(), shown.splitlines()
    assert [NUMBER.sub("#", one) for one in ours] == [NUMBER.sub("#", one) for one in theirs]
    for one, other in zip(ours, theirs, strict=True):
        numbers = [[float(x) for x in NUMBER.findall(line)] for line in (one, other)]
        assert numbers[0] == pytest.approx(numbers[1], rel=0.05), one


def write(path: Path) -> None:
    """Write the outputs of a page's blocks below them."""
    page = path.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepared_for_blocks(folder)
        outputs = iter(printed(page, folder))

    def with_output(block: re.Match[str]) -> str:
        code = f"```python\n{block['code']}```\n"
        if FILE.match(block["code"]) or not (text := shortened(next(outputs))):
            return code
        return f"{code}\n```text\n{text}\n```\n"

    path.write_text(BLOCK.sub(with_output, page), encoding="utf-8")


if __name__ == "__main__":
    for one in [Path(name).resolve() for name in sys.argv[1:]] or with_blocks():
        print(one, flush=True)
        write(one)
