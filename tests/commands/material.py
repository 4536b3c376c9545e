"""Files that the commands and code blocks in the documentation need: files shown in pages, records and a
model.
"""

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from granular import damper, load_scene, simulate
from reduced_models.records.example_records import write_example_records

from .shown import ROOT, files


def make_directory(here: Path) -> Path:
    """Fill the folder with all files that the commands need, and return it."""
    for name, text in files().items():
        (here / name).write_text(text, encoding="utf-8")
    for number, name in enumerate(("a", "b", "c", "lift-1", "lift-2", "lift-3", "light", "heavy")):
        (here / f"{name}.csv").write_text("\n".join(["t,dist", *rows(1.0 + 0.3 * number)]))
    (here / "shaken.csv").write_text("\n".join(shaken()))
    (here / "forced.csv").write_text("\n".join(forced()))
    (here / "pendulum.csv").write_text("\n".join(pendulum()))
    for name in ("my-bed", "my-damper", "mine"):
        damper(count=92).save(here / f"{name}.toml")
    load_scene("bed").save(here / "bed.toml")
    shutil.copy(ROOT / "tests" / "data" / "model.json", here)
    return here


def prepared_for_blocks(here: Path) -> Path:
    """Fill the folder with the files for Python blocks, including tables and a run, and return it."""
    make_directory(here)
    write_example_records(here / "lab")
    (here / "lab.csv").write_text("\n".join(["t,dist", *rows(1.0), ""]))
    plain = [f"{1e3 * t:.4f},{1e3 * z:.6f}" for t, z in oscillation(1.0)]
    (here / "plain.csv").write_text("\n".join(["time,height", *plain, ""]))
    pd.DataFrame(oscillation(1.0), columns=["t", "dist"]).to_excel(here / "lab.xlsx", index=False)
    (here / "shaker.csv").write_text("\n".join(forced()))
    (here / "geophone.csv").write_text("\n".join(geophone()))
    simulate(load_scene("bed"), t_end=0.5, out=here / "runs" / "bed", progress=False)
    return here


def oscillation(amplitude: float) -> Iterator[tuple[float, float]]:
    """Yield time [s] and height [m] of a decaying oscillation like the piston's in the packaged damper."""
    noise = np.random.default_rng(5).normal(size=1500)
    for time, error in zip(np.linspace(0.0, 6.0, 1500), noise, strict=True):
        fall = amplitude * np.exp(-0.8 * time) * np.cos(21.8 * time)
        yield float(time), float(0.059 + 1.2e-3 * fall + 2e-6 * error)


def rows(amplitude: float, *, sign: str = ".") -> list[str]:
    apart = ";" if sign == "," else ","
    return [apart.join(f"{x:.9f}".replace(".", sign) for x in pair) for pair in oscillation(amplitude)]


def shaken() -> list[str]:
    """Return the lines of a record with the height and the base's velocity."""
    pairs = [f"{t:.6f},{z:.9f},{0.01 * np.sin(7.0 * t):.9f}" for t, z in oscillation(1.0)]
    return ["time,height,base_speed", *pairs]


def forced() -> list[str]:
    """Return the lines of a record with the height and the force on the piston."""
    pairs = [f"{t:.6f},{z:.9f},{73.5 + 0.5 * np.sin(9.0 * t):.9f}" for t, z in oscillation(1.0)]
    return ["time,height,force", *pairs]


def geophone() -> list[str]:
    """Return the lines of a record with the voltage of a geophone (28 V s/m, 4.5 Hz) on the piston."""
    from scipy.signal import lsim

    times = np.arange(0.0, 6.0, 0.004)
    speed = np.gradient(1.2e-3 * np.exp(-0.8 * times) * np.cos(21.8 * times), times)
    omega = 2.0 * np.pi * 4.5
    _, volts, _ = lsim(([28.0, 0.0, 0.0], [1.0, 1.2 * omega, omega**2]), speed, times)
    return ["time,out", *(f"{t:.6f},{v:.9f}" for t, v in zip(times, volts, strict=True)), ""]


def pendulum() -> list[str]:
    """Return the lines of a record with the angle of a damped pendulum released at two radians."""
    from scipy.integrate import solve_ivp

    times = np.linspace(0.0, 20.0, 1000)
    solved = solve_ivp(
        lambda _, y: [y[1], -0.3 * y[1] - 2.0 * np.sin(y[0])],
        (0.0, 20.0),
        [2.0, 0.0],
        t_eval=times,
        rtol=1e-9,
        atol=1e-11,
    )
    rows = [f"{t:.6f},{z:.9f}" for t, z in zip(times, solved.y[0], strict=True)]
    return ["time [s],angle [rad]", *rows]
