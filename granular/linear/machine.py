"""Bodies and springs besides grains and piston, as matrices: those of `effects.host`.

Their coordinates are the heights of further pistons in the cell, and the displacements of a machine's bodies
over the base, from where all is at rest: the springs of a machine hold all weights. The frame of the cell
moves as the last body, or, if that carries the piston, as the last body less the piston's height. Each mass
in the cell has its velocity in the frame plus the frame's.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.effects.effect import ForceEffect
from granular.effects.host_structure import BodyTable, FurtherPiston, Host
from granular.scene.scene import Scene
from granular.schema.natural_units import Scales
from granular.shared.array_types import Float

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix


@dataclasses.dataclass(frozen=True, eq=False)
class Machine:
    """Masses, springs and guides of the bodies, in SI."""

    table: BodyTable
    gravity: float  # [m/s^2]
    start: float  # height of the piston from which springs count [m]
    free_cell_mass: float | None  # of a cell that hangs on the bed, which the piston carries [kg]
    weight_on_piston: float | None  # then [N]

    @property
    def pistons(self) -> tuple[FurtherPiston, ...]:
        """Further pistons in the cell, the first coordinates."""
        return self.table.pistons

    @property
    def size(self) -> int:
        """Number of coordinates: further pistons, and bodies of the machine."""
        return len(self.pistons) + len(self.table.chain)

    @property
    def masses(self) -> Float[np.ndarray, "b"]:
        """Masses of further pistons, and of the machine's bodies; of the last what is fixed to it [kg]."""
        names = [other.name for other in self.pistons] + list(self.table.chain[:-1])
        masses = [self.table.masses[self.table.row(name)] for name in names]
        return np.array([*masses, *([self.table.carrying_mass] if self.table.chain else [])])

    def row(self, name: str, size: int, piston: int | None) -> Float[np.ndarray, "q"]:
        """Displacement of a body over the base as a row of the coordinates."""
        result, first = np.zeros(size), size - self.size
        if name == "base":
            return result
        if name in self.table.chain:
            result[first + len(self.pistons) + self.table.chain.index(name)] = 1.0
            return result
        result += self.frame(size, piston)
        if name == "piston" and piston is not None:
            result[piston] += 1.0
        for index, other in enumerate(self.pistons):
            result[first + index] += float(other.name == name)
        return result

    def frame(self, size: int, piston: int | None) -> Float[np.ndarray, "q"]:
        """Displacement of the cell over the base as a row of the coordinates."""
        result = np.zeros(size)
        if self.table.chain:
            result[-1] = 1.0
        if self.free_cell_mass is not None:
            result[piston] = -1.0
        return result

    def _stretches(self, size: int, piston: int | None) -> Float[np.ndarray, "l q"]:
        springs = self.table.springs
        rows = [self.row(link.upper, size, piston) - self.row(link.lower, size, piston) for link in springs]
        return np.array(rows).reshape(-1, size)

    def forces(self, q: Float[np.ndarray, "q"], piston: int | None) -> Float[np.ndarray, "q"]:
        """Return forces of springs and stops, and of further pistons' weights [N]; q [m]."""
        springs, moved = self.table.springs, q.copy()
        if piston is not None:
            moved[piston] -= self.start
        rows = self._stretches(len(q), piston)
        pushes = [link.push(stretch) for link, stretch in zip(springs, rows @ moved, strict=True)]
        result = rows.T @ np.array(pushes).reshape(len(springs))
        first = len(q) - self.size
        result[first : first + len(self.pistons)] -= self.gravity * np.array(
            [other.mass for other in self.pistons]
        )
        return np.asarray(result)

    def matrix_of_links(self, name: str, size: int, piston: int | None) -> Float[np.ndarray, "q q"]:
        """Matrix of stiffness [N/m] or damping [N s/m], by its name, of all springs but stops."""
        rows = self._stretches(size, piston)
        values = [getattr(link, name) * (link.gap is None) for link in self.table.springs]
        return np.asarray(rows.T @ (np.array(values).reshape(-1, 1) * rows))

    def resistances(self, size: int, piston: int | None) -> Float[np.ndarray, "q q"]:
        """Matrix of the dashpots, and of drag in the guides of further pistons [N s/m]."""
        result, first = self.matrix_of_links("damping", size, piston), size - self.size
        for index, other in enumerate(self.pistons):
            result[first + index, first + index] += other.drag
        return result

    def mass_matrix(self, masses: Float[np.ndarray, "q"], piston: int | None) -> csc_matrix:
        """Mass matrix of all coordinates, from the masses of grains (twice) and piston [kg]."""
        from scipy.sparse import csc_matrix

        size = len(masses)
        count, inside = size - self.size, size - len(self.table.chain)
        vertical, diagonal = np.zeros(size), masses.copy()
        vertical[(count - (piston is not None)) // 2 : inside] = 1.0
        diagonal[count:] = self.masses
        carried = csc_matrix((diagonal * vertical)[:, None])
        row = csc_matrix(self.frame(size, piston)[None])
        total = float(diagonal @ vertical) + (self.free_cell_mass or 0.0)
        diagonal = csc_matrix((diagonal, (range(size), range(size))))
        return csc_matrix(diagonal + carried @ row + (carried @ row).T + total * (row.T @ row))


def machine_of(scene: Scene) -> Machine | None:
    """Return the bodies and springs of a scene; None without any."""
    host: Any = next((effect for effect in scene.effects.acting if effect.key == "host"), None)
    if host is None or not (host.bodies or host.pistons or host.springs):
        return None
    scales = Scales.from_grains(scene.grains)
    gravity = sum(
        effect.downward_acceleration(scales)
        for effect in scene.effects.acting
        if isinstance(effect, ForceEffect)
    )
    weight = host.weight_on_piston(scene.grains, scales, gravity)
    return Machine(
        host.table(scene.piston),
        gravity=gravity * scales.acceleration,
        start=0.0 if scene.piston is None else scene.piston.height,
        free_cell_mass=host.cell_mass,
        weight_on_piston=None if weight is None else weight * scales.force,
    )


def matrices_of_chain(
    host: Host,
) -> tuple[Float[np.ndarray, "b"], Float[np.ndarray, "b b"], Float[np.ndarray, "b b"]]:
    """Masses [kg], and matrices of springs [N/m] and dashpots [N s/m], of a machine's bodies alone."""
    alone = Host(mount=host.mount, cell_mass=host.cell_mass, bodies=host.bodies)
    machine = Machine(alone.table(None), 0.0, 0.0, None, None)
    springs, dashpots = (
        machine.matrix_of_links(name, machine.size, None) for name in ("stiffness", "damping")
    )
    return machine.masses, springs, dashpots
