"""What the guide says in numbers without a picture: measured here, written by ``pictures.py``."""

from __future__ import annotations

import functools
import textwrap
import warnings
from collections.abc import Callable, Mapping

import numpy as np
from scipy.integrate import solve_ivp

from granular import PistonRecord, Scene, Trajectory, load_scene, simulate
from granular.shared.errors import RecordError
from reduced_models import HeightMap, fit, judged_falls
from reduced_models.laws.elliptic_averaging import fit_averaged_motion
from validation import energy_change, head_on

TIME = np.linspace(0.0, 40.0, 1000)
DUFFING = ((0.05, 1.1, 0.8), (0.02, 1.0, -0.3), (0.1, 1.0, 0.5), (0.3, 1.0, 0.5))
"""lam, k and beta of the made laws."""
ALPHAS = (0.01, 0.03, 0.05, 0.17)
OMEGA, START = 1.05, 1.0
"""Of the Van der Pol-like law, with g0 = -1."""
FALLEN = {
    "damper": ("elastoplastic-bed", "power-law-spring", "relaxing-column"),
    "damper-source": ("elastoplastic-bed", "power-law-spring", "van-der-pol-like", "linear"),
}
"""Laws that are fitted to a fall of each scene."""
KEPT = 1e-6
"""Of the energy, by a pair that turns back."""


def made_record(law: Callable[[float, float], float], start: float) -> PistonRecord:
    """Of z'' = law(z, z'), with 1 % of noise."""
    z = solve_ivp(
        lambda _, y: [y[1], law(*y)], (0.0, TIME[-1]), [start, 0.0], "DOP853", TIME, rtol=1e-10,
        atol=1e-12,
    ).y[0]  # fmt: skip
    return PistonRecord(TIME, z + np.random.default_rng(0).normal(0.0, 0.01 * z.std(), len(z)))


def duffing(lam: float, k: float, beta: float, z: float, v: float) -> float:
    return -2.0 * lam * v - k * z - beta * z**3


def van_der_pol_like(alpha: float, z: float, v: float) -> float:
    return -1.0 - OMEGA**2 * z - 2.0 * alpha * (z**2 - 2.0 * z) * v


def off(found: Mapping[str, float], true: Mapping[str, float]) -> str:
    """By how much each number is off, in per cent."""
    errors = (100.0 * abs(found[name] / value - 1.0) for name, value in true.items())
    return ", ".join(f"{one:.1g} %" for one in errors)


def averaging() -> str:
    """Numbers of made laws by elliptic averaging, beside those of `fit`."""
    rows = ["| made law | by averaging | by `fit` |", "| --- | --- | --- |"]
    for lam, k, beta in DUFFING:
        true = {"lam": lam, "k": k, "beta": beta}
        record = made_record(functools.partial(duffing, lam, k, beta), 1.3)
        name = f"Duffing, lam {lam:g}, k {k:g}, beta {beta:g}"
        averaged = off(fit_averaged_motion(record).duffing, true)
        rows.append(f"| {name} | {averaged} | {off(fit(record, 'duffing').parameters, true)} |")
    for alpha in ALPHAS:
        true = {"alpha": alpha, "omega": OMEGA, "g0": -1.0}
        record = made_record(functools.partial(van_der_pol_like, alpha), START)
        name = f"Van der Pol-like, alpha {alpha:g}, omega {OMEGA:g}, g0 -1, from z = {START:g}"
        try:
            averaged = off(fit_averaged_motion(record).van_der_pol_like(HeightMap()), true)
        except RecordError:
            averaged = "refused"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            solved = off(fit(record, "van-der-pol-like", map=HeightMap()).parameters, true)
        rows.append(f"| {name} | {averaged} | {solved} |")
    return "\n".join([*rows, ""])


def source_swing() -> str:
    """The swing of `damper-source` by three laws: Van der Pol-like, elliptic motion, Duffing."""
    record = simulate(load_scene("damper-source"), progress=False).piston().from_zero()
    first, rest = float(record.height[0]), float(record.height[-1])
    scale = (first - rest) / (START + OMEGA**-2)
    motion = fit_averaged_motion(record)
    swing = float(np.sqrt(np.mean((record.height - rest) ** 2)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        known = HeightMap(first - scale * START, scale)
        law = fit(record, "van-der-pol-like", map=known, holdout=0.0)
        other = fit(record, "duffing", holdout=0.0)
    alpha, omega = law.parameters["alpha"], law.parameters["omega"]
    halves = {name: 0.5 * (high - low) for name, (low, high) in law.intervals.items()}
    level = 1e3 * (rest - other.parameters["rest"])
    words = (
        f"`fit` gives it alpha = {alpha:.2f} ± {halves['alpha']:.2f} 1/s and omega = {omega:.1f} ± "
        f"{halves['omega']:.1f} 1/s, a ratio of {alpha / omega:.3f}, and leaves "
        f"{100 * law.quality.relative:.1f} % of the swing, with the map held so. The damped "
        f"elliptic motion itself leaves {100 * motion.residual / swing:.1f} %, with a damping that "
        "changes its sign within the swing; so it is no Duffing law either: `fit` of one leaves "
        f"{100 * other.quality.relative:.1f} %, with k = {other.parameters['k']:.0f} 1/s² and a "
        f"rest {level:.0f} mm below the record's."
    )
    return textwrap.fill(words, 110)


def falls() -> str:
    """Laws that were fitted to one fall from 20 D, on others: two dampers."""
    rows = [
        "| damper | law | from 14 D | from 28 D | another start |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, laws in FALLEN.items():
        scene = load_scene(name)
        unseen = {
            "14 D": let_fall(scene, 14), "28 D": let_fall(scene, 28),
            "start 2": let_fall(scene, 20, 2),
        }  # fmt: skip
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            judged = judged_falls(let_fall(scene, 20), unseen, laws)
        for row in judged.rows:
            errors = " | ".join(f"{100.0 * one:.2g} %" for one in row.errors)
            rows.append(f"| `{name}` | `{row.name}` | {errors} |")
    return "\n".join([*rows, ""])


def let_fall(scene: Scene, height: int, seed: int = 1) -> PistonRecord:
    """Three seconds after the piston is let go [D]."""
    changes = {
        "piston.height": f"{height} D", "arrangement.height": f"{height - 1} D",
        "arrangement.seed": seed, "output.record": "drop",
        "protocol": [{"kind": "free", "name": "drop", "duration": 3.0}],
    }  # fmt: skip
    return simulate(scene.replace(**changes), progress=False).piston()


def collided(dt: float | str, method: str) -> Trajectory:
    """Two grains head-on, as near as 0.02 D."""
    problem = head_on(0.02)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # They come nearer than a diameter, and are meant to.
        return simulate(problem.scene, dt, problem.time, method, progress=False)


def head_on_steps() -> str:
    """Variable steps of a collision, and the fewest equal ones that keep its energy as well."""
    variable = collided("auto*8", "adaptive-verlet")
    if energy_change(variable) > KEPT:
        raise SystemExit(f"error: variable steps lose {energy_change(variable):.1e} of the energy")
    count, time = 1400, head_on(0.02).time
    while energy_change(collided(time / count, "stormer-verlet")) > KEPT:
        count = round(1.03 * count)
    steps = variable.settings()["steps"]
    return (
        f"A head-on pair that comes as near as 0.02 D keeps its energy to 10⁻⁶ with {steps} "
        f"variable steps;\n{count} equal ones do the same (looked for in jumps of 3 %)."
    )
