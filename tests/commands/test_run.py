"""Every command shown in guide, README and `--help` runs unchanged.

The commands run in one folder in the order of the pages, so that a command can read files written by an
earlier one.
"""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from granular import damper, mono_bed, simulate

from .material import make_directory, rows
from .shown import PROG, ROOT, blocks, commands, of_help

LONGEST = 1200.0
"""Seconds after which a command counts as hanging."""

HOURS = re.compile(
    r"recovery --full|report --full|validate( damper| -o|$)(?!.*--quick)|--maps --simulate"
    r"|benchmarks --prices|published --quick|disorder \w+ --full"
    r"|research\.\w+ --full"
)
"""Commands that take many minutes or hours: begun unchanged, and stopped by Ctrl-C."""
STARTED = 45.0
"""Seconds that those are given."""

MAIN_JOB = "granular-damper identify damper -o out"
SCRIPT = ["-c", "import sys; from validation.console_script import main; sys.exit(main())"]
"""Equivalent of the installed script, whose folder may not be on the path."""
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")

BROUGHT = re.compile(r"SNLS80mV\.csv")
"""Files that a user brings, and whose licence does not let them be made here."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder in which the commands run."""
    here = make_directory(tmp_path_factory.mktemp("work"))
    scene = mono_bed(368, speed=33e-3, relaxation=1.0).replace(**{"output.frames": 0.01})
    simulate(scene, t_end=20.0, out=here / "runs" / "compression", progress=False)  # as a page does
    for height in (20, 28):  # as another page's function does
        stage = {"kind": "free", "name": "drop", "duration": 3.0}
        started = {"piston.height": f"{height} D", "arrangement.height": f"{height - 1} D"}
        fall = damper().replace(**started, protocol=[stage], **{"output.record": "drop"})
        simulate(fall, progress=False).piston().to_csv(here / f"fall-{height}.csv")
    return here


def prepare(line: str, folder: Path) -> None:
    """Write `lab.csv` in the format that a command expects.

    Remove earlier outputs that an example would not replace.
    """
    words = shlex.split(line, comments=True)
    if line in of_help() and "-o" in words and not {"--resume", "sweep"} & set(words):
        target = folder / words[words.index("-o") + 1]
        shutil.rmtree(target) if target.is_dir() else target.unlink(missing_ok=True)
    if words[1] == "example":
        shutil.rmtree(folder / "lab", ignore_errors=True)  # made by another page's example
    if "--decimal ," in line:
        text = ["Messung 4", *("" for _ in range(11)), "t;dist", *rows(1.0, sign=",")]
    else:
        text = ["t,dist", *rows(1.0)]
    (folder / "lab.csv").write_text("\n".join([*text, ""]))
    if "out/model.json" in words and not (folder / "out" / "model.json").exists():
        (folder / "out").mkdir(exist_ok=True)  # a help's example has made room for its own
        shutil.copy(folder / "model.json", folder / "out")


@pytest.mark.long
@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("line", [one for one in commands() if not BROUGHT.search(one)])
def test_each_command_shown_in_the_pages_and_in_help_runs_unchanged(line: str, folder: Path) -> None:
    prepare(line, folder)
    seconds = STARTED if HOURS.search(line) else LONGEST
    status, said = ended(line, folder, seconds)
    assert "Traceback" not in said, said[-3000:]
    assert status == (130 if HOURS.search(line) else 0), said[-3000:]
    if line == MAIN_JOB:
        assert_shown(said)


def assert_shown(said: str) -> None:
    """Assert that the lines shown in the README are printed, with numbers within 1 % of the shown numbers."""
    printed: dict[str, list[list[float]]] = {}
    for one in said.splitlines():
        printed.setdefault(NUMBER.sub("#", one.strip()), []).append(numbers_of(one))
    texts = blocks("text", [ROOT / "README.md"])
    shown = [one for block in texts if "power-law" in block for one in block.splitlines()]
    assert len(shown) > 10
    for line in filter(None, map(str.strip, shown)):
        # Laws have parameters of one name: one of their lines is it.
        alike = printed.get(NUMBER.sub("#", line), [])
        assert any(one == pytest.approx(numbers_of(line), rel=0.01) for one in alike), line


def numbers_of(line: str) -> list[float]:
    return [float(one) for one in NUMBER.findall(line)]


def ended(line: str, folder: Path, seconds: float) -> tuple[int, str]:
    """Run a command, stop it with Ctrl-C after some seconds, and return its exit status and last output."""
    words = shlex.split(line, comments=True)
    paths = os.pathsep.join((str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])))
    start = [sys.executable, *(SCRIPT if words[0] == PROG else [])]
    command = subprocess.Popen(
        [*start, *words[1:]],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": paths},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        said, _ = command.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        os.killpg(command.pid, signal.SIGINT)
        said, _ = command.communicate(timeout=60.0)
    return command.returncode, said
