"""Every command that guide, README and `--help` show runs, as it stands there.

They run one after the other in one folder, in the order of the pages: what one makes, another
reads.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from granular import damper, load_scene

from .shown import ROOT, blocks, commands, files, of_help

LONGEST = 1200.0
"""Seconds after which a command counts as hanging."""

HOURS = re.compile(
    r"recovery --full|report --full|validation report( |$)(?!.*--quick)|maps --simulate"
    r"|validation prices|published --quick"
)
"""Commands that take many minutes or hours: begun as they stand, and stopped by Ctrl-C."""
BEGUN = 45.0
"""Seconds that those are given."""

MAIN_JOB = "python -m reduced_models identify damper -o out"
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")

BROUGHT = re.compile(r"SNLS80mV\.csv")
"""Files that a user brings, and whose licence does not let them be made here."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the commands run: the files that the pages print, records and scenes."""
    here = tmp_path_factory.mktemp("work")
    for name, text in files().items():
        (here / name).write_text(text, encoding="utf-8")
    for number, name in enumerate(("a", "b", "c", "lift-1", "lift-2", "lift-3")):
        (here / f"{name}.csv").write_text("\n".join(["t,dist", *rows(1.0 + 0.3 * number)]))
    (here / "shaken.csv").write_text("\n".join(shaken()))
    (here / "forced.csv").write_text("\n".join(forced()))
    (here / "pendulum.csv").write_text("\n".join(pendulum()))
    for name in ("my-bed", "my-damper", "mine"):
        damper(count=92).save(here / f"{name}.toml")
    load_scene("bed").save(here / "bed.toml")
    (here / "model.json").write_bytes(
        (ROOT / "tests" / "data" / "former" / "model.json").read_bytes()
    )
    return here


def swing(amplitude: float) -> Iterator[tuple[float, float]]:
    """A decaying motion like that of the packaged damper: seconds and metres."""
    noise = np.random.default_rng(5).normal(size=1500)
    for time, error in zip(np.linspace(0.0, 6.0, 1500), noise, strict=True):
        fall = amplitude * np.exp(-0.8 * time) * np.cos(21.8 * time)
        yield float(time), float(0.059 + 1.2e-3 * fall + 2e-6 * error)


def rows(amplitude: float, *, sign: str = ".") -> list[str]:
    apart = ";" if sign == "," else ","
    return [apart.join(f"{x:.9f}".replace(".", sign) for x in pair) for pair in swing(amplitude)]


def shaken() -> list[str]:
    """Beside the height the speed of the base."""
    pairs = [f"{t:.6f},{z:.9f},{0.01 * np.sin(7.0 * t):.9f}" for t, z in swing(1.0)]
    return ["time,height,base_speed", *pairs]


def forced() -> list[str]:
    """Beside the height the force on the piston."""
    pairs = [f"{t:.6f},{z:.9f},{73.5 + 0.5 * np.sin(9.0 * t):.9f}" for t, z in swing(1.0)]
    return ["time,height,force", *pairs]


def pendulum() -> list[str]:
    """Angle of a damped pendulum that is let go at two radians."""
    from scipy.integrate import solve_ivp

    times = np.linspace(0.0, 20.0, 1000)
    solved = solve_ivp(
        lambda _, y: [y[1], -0.3 * y[1] - 2.0 * np.sin(y[0])], (0.0, 20.0), [2.0, 0.0],
        t_eval=times, rtol=1e-9, atol=1e-11,
    )  # fmt: skip
    rows = [f"{t:.6f},{z:.9f}" for t, z in zip(times, solved.y[0], strict=True)]
    return ["time [s],angle [rad]", *rows]


def prepare(line: str, folder: Path) -> None:
    """Write `lab.csv` in the form of which the command speaks, and make room for a help's example.

    Files of the same name as in the guide are gone then: one was followed, or the other.
    """
    words = shlex.split(line, comments=True)
    if line in of_help() and "-o" in words and not {"--resume", "sweep"} & set(words):
        target = folder / words[words.index("-o") + 1]
        shutil.rmtree(target) if target.is_dir() else target.unlink(missing_ok=True)
    if "--decimal ," in line:
        text = ["Messung 4", *("" for _ in range(11)), "t;dist", *rows(1.0, sign=",")]
    else:
        text = ["t,dist", *rows(1.0)]
    (folder / "lab.csv").write_text("\n".join([*text, ""]))
    if "out/model.json" in words and not (folder / "out" / "model.json").exists():
        (folder / "out").mkdir(exist_ok=True)  # a help's example has made room for its own
        shutil.copy(folder / "model.json", folder / "out")


@pytest.mark.long
@pytest.mark.parametrize("line", [one for one in commands() if not BROUGHT.search(one)])
def test_it_runs_as_it_stands(line: str, folder: Path) -> None:
    prepare(line, folder)
    seconds = BEGUN if HOURS.search(line) else LONGEST
    status, said = ended(line, folder, seconds)
    assert "Traceback" not in said, said[-3000:]
    assert status == (130 if HOURS.search(line) else 0), said[-3000:]
    if line == MAIN_JOB:
        assert_shown(said)


def assert_shown(said: str) -> None:
    """What the README shows of the main job is printed, its numbers to a hundredth."""
    printed: dict[str, list[list[float]]] = {}
    for one in said.splitlines():
        printed.setdefault(NUMBER.sub("#", one.strip()), []).append(numbers_of(one))
    shown = [one for block in blocks("text") if "power-law" in block for one in block.splitlines()]
    assert len(shown) > 10
    for line in filter(None, map(str.strip, shown)):
        # Laws have parameters of one name: one of their lines is it.
        alike = printed.get(NUMBER.sub("#", line), [])
        assert any(one == pytest.approx(numbers_of(line), rel=0.01) for one in alike), line


def numbers_of(line: str) -> list[float]:
    return [float(one) for one in NUMBER.findall(line)]


def ended(line: str, folder: Path, seconds: float) -> tuple[int, str]:
    """Exit status of a command and its last words; Ctrl-C after some seconds."""
    words = shlex.split(line, comments=True)
    paths = os.pathsep.join((str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])))
    command = subprocess.Popen(
        [sys.executable, *words[1:]], cwd=folder, env=os.environ | {"PYTHONPATH": paths},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
    )  # fmt: skip
    try:
        said, _ = command.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        os.killpg(command.pid, signal.SIGINT)
        said, _ = command.communicate(timeout=60.0)
    return command.returncode, said
