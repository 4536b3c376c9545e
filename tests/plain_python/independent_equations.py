"""Independent equations of motion of grains, piston, cell and machine, solved by SciPy's DOP853.

They follow the formulas of the guide in SI units, relative to the base, and import nothing from the
time loop. Velocities of grains and of a free piston are relative to the base. A driven piston is a
constraint: the total momentum of cell and piston replaces their velocities.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

REMANENCE, DENSITY, THICKNESS, GRAVITY, MU_0 = 1.3, 7368.0, 3e-3, 9.8, 4e-7 * math.pi
"""[T], [kg/m^3], [m], [m/s^2], [N/A^2]: the grain of the model, and the weight."""

Course = Callable[[float], tuple[float, float]]
"""Height [m] and velocity [m/s] of the driven piston at a time in its stage [s]."""


@dataclasses.dataclass(frozen=True)
class Case:
    """A bed on a machine, in SI, with machine and stages as in a scene."""

    diameters: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    width: float
    height: float
    mass: float
    piston_drag: float
    drag: float
    weight: bool
    springs: tuple[tuple[float, float], ...]
    host: dict[str, Any]
    stages: tuple[dict[str, Any], ...]
    eddy: dict[str, Any] | None = None


@dataclasses.dataclass
class Instant:
    """Coordinates and velocities of grains, of all bodies except the last, of cell and piston.

    Grains are relative to the base.
    """

    grains: np.ndarray
    speeds: np.ndarray
    bodies: np.ndarray
    body_speeds: np.ndarray
    cell: float
    cell_speed: float
    piston: float
    piston_speed: float


class Equations:
    """Masses, magnetic moments and forces of a case."""

    def __init__(self, case: Case) -> None:
        self.case, self.mount = case, case.host.get("mount", "none")
        volume = math.pi / 4.0 * THICKNESS * case.diameters**2
        self.masses, moments = DENSITY * volume, REMANENCE / MU_0 * volume
        self.ratios, self.size = moments / moments[0], case.diameters[0]
        self.unit = MU_0 * moments[0] ** 2 / (math.pi * self.size**4)
        self.pairs = 3.0 * MU_0 / (4.0 * math.pi) * np.outer(moments, moments)
        self.moments = moments
        bodies = case.host.get("bodies", [])
        self.body_masses = np.array([body["mass"] for body in bodies])
        self.stiffness = np.array([body["stiffness"] for body in bodies])
        self.damping = np.array([body["damping"] for body in bodies])
        self.moves = self.mount in ("cell", "piston")
        self.piston_mass = case.mass + (self.body_masses[-1] if self.mount == "piston" else 0.0)
        self.cell_mass = {"cell": self.body_masses[-1:].sum(), "piston": case.host.get("cell_mass", 0.0)}.get(
            self.mount, math.inf
        )
        self.recoil = self.piston_mass / (self.cell_mass + self.piston_mass) if self.moves else 0.0

    def excitation(self, time: float) -> tuple[float, float]:
        """Return the external force [N] and the acceleration of the base [m/s^2]."""
        drive = self.case.host.get("excitation")
        if drive is None:
            return 0.0, 0.0
        omega = math.tau * drive["frequency"]
        wave = math.sin(omega * time)
        if "force" in drive:
            return drive["force"] * wave, 0.0
        return 0.0, drive["acceleration"] * wave if "acceleration" in drive else -drive[
            "displacement"
        ] * omega**2 * wave

    def forces(self, now: Instant, time: float) -> tuple[np.ndarray, np.ndarray, float, float]:
        """Return the forces on the grains, on all bodies except the last, on the cell and on the piston."""
        case, inside = self.case, now.grains - [0.0, now.cell]
        apart = inside[:, None] - inside
        r = np.hypot(*apart.T).T + np.diag(np.full(len(inside), np.inf))
        on = (self.pairs[..., None] * apart / r[..., None] ** 5).sum(axis=1)
        reaction = 0.0

        def wall(distance: np.ndarray) -> np.ndarray:
            return 0.5 * self.unit * self.ratios * (self.size / distance) ** 3.5

        on[:, 0] += wall(inside[:, 0]) - wall(case.width - inside[:, 0])
        bottom, top = wall(inside[:, 1]), wall(now.piston - now.cell - inside[:, 1])
        inner_speeds = now.speeds - [0.0, now.cell_speed]
        damped = -case.drag * self.ratios[:, None] * inner_speeds + self.eddy_forces(apart, inner_speeds)
        held = -sum((k * (inside[:, 1] - h) for k, h in case.springs), start=np.zeros(len(inside)))
        on += damped
        on[:, 1] += bottom - top + held
        reaction = -(bottom + damped[:, 1] + held).sum()
        on_piston = float(top.sum())
        g = GRAVITY * case.weight * (-1.0 if self.mount == "piston" else 1.0)
        on[:, 1] -= self.masses * g
        loads = self.masses.sum()
        if self.mount == "piston":  # the springs' rest lengths hold grains, cell and piston
            on_piston += (self.cell_mass + loads) * g
            reaction -= self.cell_mass * g
        else:
            on_piston -= self.piston_mass * g
            reaction += (loads + self.piston_mass) * g
        outer, base = self.excitation(time)
        on_bodies = self.chain_forces(now)
        if len(on_bodies):
            on_bodies[self.case.host.get("excited", len(on_bodies) - 1)] += outer
        on[:, 1] -= self.masses * base
        if self.moves:
            on_bodies[:-1] -= self.body_masses[:-1] * base
            reaction -= self.cell_mass * base
            last = on_bodies[-1]
            reaction, on_piston = (
                (reaction + last, on_piston) if self.mount == "cell" else (reaction, on_piston + last)
            )
        on_piston -= self.piston_mass * base
        return on, on_bodies[:-1], reaction, on_piston

    def eddy_forces(self, apart: np.ndarray, speeds: np.ndarray) -> np.ndarray:
        """Return the drag by eddy currents that the grains induce in thin plates (Reitz 1970,
        doi:10.1063/1.1659172).
        """
        plate = self.case.eddy
        if plate is None:
            return np.zeros_like(speeds)
        sheet = plate["plates"] * plate["conductivity"] * plate["thickness"]
        rate = 3.0 * MU_0**2 * sheet / (128.0 * math.pi * plate["distance"] ** 4)
        square = (2.0 * plate["distance"]) ** 2
        total = square + (apart**2).sum(axis=-1)
        own, outer = np.eye(2), apart[..., :, None] * apart[..., None, :]
        tensor = (square / total)[..., None, None] ** 2.5 * (own - 5.0 * outer / total[..., None, None])
        if not plate["mutual"]:
            tensor = np.eye(len(speeds))[..., None, None] * tensor
        return np.asarray(-rate * np.einsum("i,j,ijkl,jl->ik", self.moments, self.moments, tensor, speeds))

    def last_body(self, now: Instant) -> tuple[float, float]:
        """Return displacement and velocity of the body that carries cell or piston."""
        if self.mount == "piston":
            return now.piston - self.case.height, now.piston_speed
        return now.cell, now.cell_speed

    def chain_forces(self, now: Instant) -> np.ndarray:
        """Return the forces of springs and dashpots on all bodies."""
        if not self.moves:
            return np.zeros(0)
        place, speed = self.last_body(now)
        ways = np.diff([0.0, *now.bodies, place])
        rates = np.diff([0.0, *now.body_speeds, speed])
        own = self.stiffness * ways + self.damping * rates
        return np.append(own[1:], 0.0) - own


class Stretch:
    """The equations for a part of a stage, with a free or a driven piston."""

    def __init__(
        self, equations: Equations, push: Callable[[float], float], course: Course | None, start: float
    ) -> None:
        self.equations, self.push, self.course, self.start = equations, push, course, start

    def pack(self, now: Instant) -> np.ndarray:
        """Return the state as one vector."""
        it = self.equations
        tail = [now.cell, now.cell_speed, now.piston, now.piston_speed]
        if self.course is not None and it.moves:
            tail = [now.cell, it.cell_mass * now.cell_speed + it.piston_mass * now.piston_speed]
        elif self.course is not None:
            tail = []
        return np.concatenate([now.grains.ravel(), now.speeds.ravel(), now.bodies, now.body_speeds, tail])

    def unpack(self, time: float, row: np.ndarray) -> Instant:
        """Return the state from a vector at a time in the stage."""
        it = self.equations
        grains, bodies = 2 * len(it.masses), max(len(it.body_masses) - 1, 0)
        parts = np.split(row, np.cumsum([grains, grains, bodies, bodies]))
        tail = list(parts[4])
        if self.course is not None:
            height, speed = self.course(time)
            cell, cell_speed = 0.0, 0.0
            if it.moves:
                cell, momentum = tail
                cell_speed = (momentum - it.piston_mass * speed) / (it.cell_mass + it.piston_mass)
            tail = [cell, cell_speed, cell + height, cell_speed + speed]
        return Instant(parts[0].reshape(-1, 2), parts[1].reshape(-1, 2), parts[2], parts[3], *tail)

    def rates(self, time: float, row: np.ndarray) -> np.ndarray:
        """Return the time derivative of the state vector."""
        it, now = self.equations, self.unpack(time, row)
        on, on_bodies, on_cell, on_piston = it.forces(now, self.start + time)
        tail: list[float] = []
        if self.course is None:
            rubbed = it.case.piston_drag * (now.piston_speed - now.cell_speed)
            cell = (on_cell + rubbed) / it.cell_mass if it.moves else 0.0
            piston = (on_piston + self.push(time) - rubbed) / it.piston_mass
            tail = [now.cell_speed, cell, now.piston_speed, piston]
        elif it.moves:
            tail = [now.cell_speed, on_cell + on_piston]
        accelerations = (on / it.masses[:, None]).ravel()
        bodies = on_bodies / it.body_masses[:-1] if it.moves else on_bodies
        return np.concatenate([now.speeds.ravel(), accelerations, now.body_speeds, bodies, tail])


def solve(case: Case) -> dict[str, np.ndarray]:
    """Return the state at the end of the stages, with the names of a run's dataset such as ``position``
    [m].
    """
    equations = Equations(case)
    bodies = np.zeros(max(len(equations.body_masses) - 1, 0))
    now = Instant(case.positions, case.velocities.copy(), bodies, bodies.copy(), 0.0, 0.0, case.height, 0.0)
    start = 0.0
    for stage in case.stages:
        jump = _jump(stage, now.piston - now.cell)
        now.cell -= equations.recoil * jump
        now.piston += (1.0 - equations.recoil) * jump
        push, parts = _plan(stage, now.piston - now.cell)
        for first, last, course in parts:
            stretch = Stretch(equations, push, course, start)
            row = stretch.pack(now)
            if last > first:
                found = solve_ivp(stretch.rates, (first, last), row, method="DOP853", rtol=1e-12, atol=1e-14)
                assert found.success
                row = found.y[:, -1]
            now = stretch.unpack(last, row)
        start += parts[-1][1]
    result = {"position": now.grains - [0.0, now.cell], "piston_height": np.array(now.piston - now.cell)}
    if equations.moves:
        result["host_displacement"] = np.array(equations.last_body(now)[0])
        result |= {f"body_{k}_displacement": np.array(place) for k, place in enumerate(now.bodies)}
    return result


def _jump(stage: dict[str, Any], height: float) -> float:
    """Return the jump [m] of the piston at the start of the stage."""
    if stage["kind"] == "follow":
        return float(stage["heights"][0]) - height
    return float(stage.get("by", 0.0))


def _no_push(time: float) -> float:
    return 0.0


def _plan(
    stage: dict[str, Any], height: float
) -> tuple[Callable[[float], float], list[tuple[float, float, Course | None]]]:
    """Return the external force over time, and the smooth parts of the stage.

    Each part has a begin, an end, and the path of a driven piston.
    """
    kind, duration = stage["kind"], stage.get("duration", 0.0)
    if kind in ("free", "push", "force", "fade"):
        return _force(stage), [(0.0, duration, None)]
    return _no_push, list(_courses(stage, height, duration))


def _force(stage: dict[str, Any]) -> Callable[[float], float]:
    if stage["kind"] == "push":
        omega = math.tau * stage["frequency"]
        return lambda t: float(stage["mean"] + stage["amplitude"] * math.sin(omega * t))
    if stage["kind"] == "force":
        return lambda t: float(stage["f"] * math.exp(-t / stage["s"]))
    if stage["kind"] == "fade":
        size, span = stage["size"], stage["span"]
        return lambda t: float(size * (math.exp(-t / span) - math.sin(t / span)))
    return _no_push


def _courses(
    stage: dict[str, Any], height: float, duration: float
) -> Iterator[tuple[float, float, Course | None]]:
    kind = stage["kind"]
    if kind == "follow":
        times, heights = stage["times"], stage["heights"]
        for a, b, low, high in zip(times, times[1:], heights, heights[1:], strict=False):
            yield a, b, _line(low, (high - low) / (b - a), a)
    elif kind == "move":
        yield 0.0, duration, _line(height, (stage["to"] - height) / duration, 0.0)
    elif kind in ("hold", "lift"):
        yield 0.0, duration, _line(height, 0.0, 0.0)
    elif kind == "oscillate":
        a, omega = stage["amplitude"], math.tau * stage["frequency"]
        yield 0.0, duration, lambda t: (height + a * math.sin(omega * t), a * omega * math.cos(omega * t))
    elif kind == "descend":
        k, down = stage["steepness"], height - stage["to"]
        yield (
            0.0,
            duration,
            lambda t: (
                height - down * math.expm1(k * t / duration) / math.expm1(k),
                -down * k / duration * math.exp(k * t / duration) / math.expm1(k),
            ),
        )
    else:  # "path" and "dip" are one
        a, w = (stage["a"], stage["w"]) if kind == "path" else (stage["depth"], stage["omega"])
        yield 0.0, duration, lambda t: (height - a * (1.0 - math.cos(w * t)), -a * w * math.sin(w * t))


def _line(height: float, speed: float, begin: float) -> Course:
    return lambda t: (height + speed * (t - begin), speed)
