"""Tables of measured values in the guide, written by ``pictures.py``."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import numpy as np
from scipy.integrate import solve_ivp

from granular import PistonRecord, Scene, Trajectory, damper, load_scene, simulate
from granular.pairs.disc_law import Disc, disc_energy_and_force
from reduced_models import fit, predict, score_drops
from reduced_models.falls.predicted_law import lattice_pressure
from reduced_models.identification.elliptic_averaging import (
    OSCILLATORS,
    averaged_amplitude,
    averaged_frequency,
    maximum_damping_over_rate,
)
from reduced_models.records.envelope import envelope
from validation import energy_change, head_on_collision

TIME = np.linspace(0.0, 40.0, 1000)
DUFFING = ((0.05, 1.1, 0.8), (0.02, 1.0, -0.3), (0.1, 1.0, 0.5), (0.3, 1.0, 0.5))
"""lam, k and beta of the synthetic laws."""
ALPHAS = (0.01, 0.03, 0.05, 0.17)
OMEGA, START = 1.05, 1.0
"""Parameters of the Van der Pol-like law, with g0 = -1."""
FALLEN = {
    "damper": ("elastoplastic-bed", "power-law-spring", "relaxing-column"),
    "damper-source": ("elastoplastic-bed", "power-law-spring", "van-der-pol-like", "linear"),
}
"""Laws fitted to a fall of each scene."""
KEPT = 1e-6
"""Maximum change of the energy of a colliding pair."""


def averaging() -> str:
    """Amplitudes and frequencies of synthetic laws, exact and by elliptic averaging."""
    head = "| synthetic law | damping | last amplitude | averaged | last frequency | averaged |"
    rows = [head, "| --- " * 6 + "|"]
    for lam, k, beta in DUFFING:
        values = {"lam": lam, "k": k, "beta": beta, "rest": 0.0}
        name = f"Duffing, lam {lam:g}, k {k:g}, beta {beta:g}, from 1.3"
        rows.append(averaged(name, "duffing", values, 1.3))
    for alpha in ALPHAS:
        values = {"alpha": alpha, "omega": OMEGA, "g0": -1.0, "shift": 0.0, "scale": 1.0}
        name = f"Van der Pol-like, alpha {alpha:g}, omega {OMEGA:g}, g0 -1, from z = {START:g}"
        rows.append(averaged(name, "van-der-pol-like", values, START))
    return "\n".join([*rows, ""])


def averaged(name: str, law: str, values: Mapping[str, float], start: float) -> str:
    """A row of the table, for the last complete cycle within 40 s."""
    one = OSCILLATORS[law](values)
    rest = values["rest"] if "rest" in values else values["g0"] / values["omega"] ** 2

    def slopes(_: float, y: np.ndarray) -> list[float]:
        x, v = y
        drag = 2.0 * (one.decay + one.tilt * x + one.bend * x**2) * v
        return [v, -drag - one.k * x - one.beta * x**3]

    found = solve_ivp(slopes, (0.0, TIME[-1]), [start - rest, 0.0], "DOP853", TIME, rtol=1e-10, atol=1e-12)
    cycles = envelope(PistonRecord(TIME, found.y[0]))
    amplitude = averaged_amplitude(cycles.time, float(cycles.amplitude[0]), one)
    tone = averaged_frequency(amplitude, one)[-1]
    return (
        f"| {name} | {maximum_damping_over_rate(float(cycles.amplitude[0]), one):.2g} | "
        f"{cycles.amplitude[-1]:.3g} | {amplitude[-1]:.3g} | "
        f"{cycles.frequency[-1] / (2.0 * np.pi):.4f} Hz | {tone:.4f} Hz |"
    )


def falls() -> str:
    """Prediction of other falls by laws fitted to one fall from 20 D, for two dampers."""
    rows = ["| damper | law | from 14 D | from 28 D | another start |", "| --- | --- | --- | --- | --- |"]
    for name, laws in FALLEN.items():
        scene = load_scene(name)
        unseen = {
            "14 D": simulate_fall(scene, 14),
            "28 D": simulate_fall(scene, 28),
            "start 2": simulate_fall(scene, 20, 2),
        }
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            judged = score_drops(simulate_fall(scene, 20), unseen, laws)
        for row in judged.rows:
            errors = " | ".join(f"{100.0 * one:.2g} %" for one in row.errors)
            rows.append(f"| `{name}` | `{row.name}` | {errors} |")
    return "\n".join([*rows, ""])


def simulate_fall(scene: Scene, height: int, seed: int = 1) -> PistonRecord:
    """Simulate three seconds after the piston is released from a height [D]."""
    changes = {
        "piston.height": f"{height} D",
        "arrangement.height": f"{height - 1} D",
        "arrangement.seed": seed,
        "output.record": "drop",
        "protocol": [{"kind": "free", "name": "drop", "duration": 3.0}],
    }
    return simulate(scene.replace(**changes), progress=False).piston()


def discs_over_dipoles() -> str:
    """Repulsion of two discs half as thick as wide, and pressure of their lattice, relative to dipoles."""
    r, disc = np.array([1.0, 1.1, 1.2, 1.3, 1.5, 2.0, 3.0, 5.0]), Disc(0.5, 0.5)
    forces = disc_energy_and_force(r, disc, disc)[1] * r**4 / 3.0
    dipoles, discs = (damper(magnets=magnets).grains for magnets in ("dipoles", "cylinders"))
    densities = 2.0 / (np.sqrt(3.0) * r**2)
    pressures = [lattice_pressure(discs, rho) / lattice_pressure(dipoles, rho) for rho in densities]
    rows = [["r/D", *(f"{one:g}" for one in r)], ["---"] * (len(r) + 1)]
    rows += [["repulsion of two discs", *(f"{one:.3f}" for one in forces)]]
    rows += [["pressure of the lattice", *(f"{one:.3f}" for one in pressures)]]
    return "\n".join([*(f"| {' | '.join(row)} |" for row in rows), ""])


def magnets_compared_with_dipoles() -> str:
    """Equilibrium height, period and damping ratio of the scene `magnets`, with discs and with dipoles."""
    rows = ["| | discs | dipoles | discs by `predict` |", "| --- " * 4 + "|"]
    of_discs, of_dipoles = (rest_figures(magnets) for magnets in ("cylinders", "dipoles"))
    told = predict(load_scene("magnets")).at_rest
    assert told is not None
    said = (1e3 * told.height, told.period, told.damping_ratio)
    for name, digits, discs, dipoles, law in zip(
        ("rest [mm]", "period [s]", "damping ratio"), (2, 4, 4), of_discs, of_dipoles, said, strict=True
    ):
        measured = (f"{x:.{digits}f} ± {start:.1g} ± {step:.1g}" for x, start, step in (discs, dipoles))
        rows.append(f"| {name} | {' | '.join(measured)} | {law:.{digits}f} |")
    return "\n".join([*rows, ""])


def rest_figures(magnets: str) -> list[tuple[float, float, float]]:
    """Equilibrium height [mm], period [s], damping ratio: mean and deviation of three packings, step
    error.
    """
    figures = {}
    for seed, dt in ((1, "auto*2"), (2, "auto*2"), (3, "auto*2"), (1, "auto")):
        scene = load_scene("magnets").replace(**{"grains.magnets": magnets, "arrangement.seed": seed})
        rest = fit(simulate(scene, dt=dt, progress=False).piston(), "linear").at_rest
        figures[seed, dt] = (1e3 * rest.height, rest.period, rest.damping_ratio)
    starts = np.array([figures[seed, "auto*2"] for seed in (1, 2, 3)])
    steps = np.abs(np.array(figures[1, "auto"]) - starts[0])
    return list(zip(starts.mean(axis=0), starts.std(axis=0, ddof=1), steps, strict=True))


def collided(dt: float | str, method: str) -> Trajectory:
    """Head-on collision of two grains, to a distance of 0.02 D."""
    problem = head_on_collision(0.02)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # The grains intentionally come closer than a diameter.
        return simulate(problem.scene, dt, problem.time, method, progress=False)


def head_on_steps() -> str:
    """Number of variable steps of a collision, and the minimum number of equal steps with the same energy
    error.
    """
    variable = collided("auto*8", "adaptive-verlet")
    if energy_change(variable) > KEPT:
        raise SystemExit(f"error: variable steps lose {energy_change(variable):.1e} of the energy")
    count, time = 1400, head_on_collision(0.02).time
    while energy_change(collided(time / count, "stormer-verlet")) > KEPT:
        count = round(1.03 * count)
    steps = variable.settings()["steps"]
    return (
        "A head-on collision of two grains that approach to a distance of 0.02 D conserves energy to 10⁻⁶\n"
        f"with {steps} variable steps. With equal steps, {count} steps (to within 3 %) are needed for the "
        "same error."
    )
