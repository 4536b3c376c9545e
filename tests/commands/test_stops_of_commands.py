"""Ctrl-C or SIGTERM at a random time ends every long command with one line and the right exit status."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from granular import load_scene
from tests.processes import living

from .material import rows
from .shown import ROOT

STOPS = 6
"""Stops of each command, with code compiled before and without: 60 in all."""

LATEST = {"warm": 12.0, "cold": 40.0}
"""Seconds after the start up to which stops are drawn: about as long as `fit` takes."""

ENDS_WITHIN = 30.0
"""Seconds: on two busy cores the processes of a pool take several to end."""

COMMANDS = {
    "fit": "reduced_models fit lab.csv --law power-law-spring -o model.json",
    "identify": "reduced_models identify lab.csv -o out",
    "discover": "reduced_models discover lab.csv",
    "sweep": "granular sweep study.toml -o out",
    "design": "reduced_models design --frequency 3.3 --damping 0.1 -o out",
}

SIGNALS = [(signal.SIGINT, True), (signal.SIGTERM, False), (signal.SIGINT, False), (signal.SIGTERM, True)]
"""A terminal sends Ctrl-C to the whole group, ``kill`` a signal to one process."""

pytestmark = [
    pytest.mark.skipif(not Path("/proc").is_dir(), reason="finds processes in /proc"),
    pytest.mark.usefixtures("interruptible"),
]


def make_folder(folder: Path) -> Path:
    """Fill the folder with a record and a study of short runs, and return it."""
    (folder / "lab.csv").write_text("\n".join(["t,dist", *rows(1.0), ""]))
    stage = {"kind": "hold", "name": "fall", "duration": 0.5}
    load_scene("single-particle").replace(protocol=[stage]).save(folder / "fall.toml")
    values = ", ".join(f"{1.0 + 0.001 * k}" for k in range(400))
    (folder / "study.toml").write_text(
        f'scene = "fall.toml"\ndt = 1e-6\n[grid]\n"effects.gravity.acceleration" = [{values}]\n'
    )
    return folder


def catches_sigterm(pid: int) -> bool:
    """Return True once the command has started. Before that, Python and not the toolkit handles a signal."""
    status = Path(f"/proc/{pid}/status").read_text()
    caught = next(line for line in status.splitlines() if line.startswith("SigCgt"))
    return bool(int(caught.split()[1], 16) >> (signal.SIGTERM - 1) & 1)


def stop_command(
    words: str, folder: Path, delay: float, number: signal.Signals, to_group: bool, cache: Path | None
) -> str | None:
    """Stop a command after a delay [s].

    Return a description of faults in how it stopped, which is empty if there are none. Return None if the
    command had already ended.
    """
    own = {} if cache is None else {"XDG_CACHE_HOME": str(cache)}
    command = subprocess.Popen(
        [sys.executable, "-m", *words.split(), "--quiet"],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)} | own,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        while command.poll() is None and not catches_sigterm(command.pid):
            time.sleep(0.01)
        try:
            command.wait(delay)
        except subprocess.TimeoutExpired:
            (os.killpg if to_group else os.kill)(command.pid, number)
        else:
            return None
        said = command.communicate(timeout=ENDS_WITHIN)[1]
        lines = [line for line in said.splitlines() if not line.startswith("warning: ")]
        wrong = []
        if command.returncode != 128 + number:
            wrong.append(f"status {command.returncode}")
        if len(lines) != 1 or not lines[0].startswith("error: "):
            wrong.append(f"{len(lines)} lines: {said[-1500:]}")
        until = time.monotonic() + ENDS_WITHIN
        while (left := living(command.pid)) and time.monotonic() < until:
            time.sleep(0.1)
        if left:
            wrong.append(f"{len(left)} processes left")
        return ", ".join(wrong)
    except subprocess.TimeoutExpired:
        return f"no end within {ENDS_WITHIN:g} s"
    finally:
        if living(command.pid):
            os.killpg(command.pid, signal.SIGKILL)
        command.communicate()


@pytest.mark.long  # quick: stops in every kind of code that wraps one, in granular/shared/test_stops.py
@pytest.mark.parametrize("compiled", list(LATEST))
@pytest.mark.parametrize("name", list(COMMANDS))
def test_a_stop_signal_at_a_random_time_ends_a_command_with_one_line(
    name: str, compiled: str, tmp_path: Path
) -> None:
    random = np.random.default_rng([*COMMANDS].index(name) + 100 * (compiled == "cold"))
    wrong = []
    for k in range(STOPS):
        folder = tmp_path / str(k)
        folder.mkdir()
        make_folder(folder)
        number, to_group = SIGNALS[k % len(SIGNALS)]
        delay, said = LATEST[compiled] * random.random(), None
        while said is None:
            cache = folder / f"cache-{delay:.3f}" if compiled == "cold" else None
            said = stop_command(COMMANDS[name], folder, delay, number, to_group, cache)
            what = f"{name}, {compiled}, {number.name}{' to the group' if to_group else ''}, {delay:.2f} s"
            print(f"{what}: {'ended before' if said is None else said or 'one line'}", flush=True)
            delay *= 0.5
        wrong += [f"{what}: {said}"] if said else []
    assert not wrong, "\n".join(wrong)
