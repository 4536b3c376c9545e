"""Forces and resistance of a bed and the machine that carries it, at given coordinates.

The coordinates are q = (x_1 ... x_n, y_1 ... y_n, z, Z_1 ... Z_p, X_1 ... X_b): the grains, the piston and
further pistons in the frame of the cell, and the displacements of a machine's bodies. Every derivative is a
finite difference of these forces. Effects, walls and pair laws, including user-defined ones, therefore need
no formula for their stiffness. With a displacement of 5e-4 D the error of the fourth-order stencil for
dipoles is 3e-12 times the largest stiffness.

Further pistons, and the bodies and springs of a machine (`effects.host`), are represented by matrices. The
displacement of a machine's body is relative to the base and is measured from the equilibrium in which the
springs of the machine carry all weights. The cell moves with the last body of the machine. If that body
carries the piston instead of the cell, the displacement of the cell is the displacement of the body minus the
height of the piston in the cell. The velocity of each mass in the cell is its velocity relative to the cell
plus the velocity of the cell.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.effects.effect import ForceEffect
from granular.effects.gravity import GravityLaw
from granular.effects.host_structure import FurtherPiston, Host, SceneBodies
from granular.engine import columns
from granular.engine.forces import force_components_with_far_field
from granular.engine.run_errors import report_arithmetic_errors_as
from granular.engine.step_size import StepSchedule
from granular.kernel_data.state import HEIGHT, SPEED
from granular.run.engines import NO_STOP_CRITERIA, NO_TICKS
from granular.run.plan import plan
from granular.run.run_state import RunState
from granular.scene.scene import Scene
from granular.schema.cell import PISTON, Heights, piston_wall_key
from granular.schema.natural_units import Scales
from granular.schema.sections import find_value
from granular.shared.array_types import Float
from granular.shared.errors import InputError, RunError, quote

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix


@dataclasses.dataclass(frozen=True, eq=False)
class Machine:
    """Masses, springs and guides of further pistons and of a machine's bodies, in SI."""

    table: SceneBodies
    gravity: float  # [m/s^2]
    start: float  # height of the piston at which springs are unstretched [m]
    free_cell_mass: float | None  # mass of a cell that hangs on a bed carried by the piston [kg]
    cell_weight_on_piston: float | None  # weight on the piston in that case [N]

    @property
    def pistons(self) -> tuple[FurtherPiston, ...]:
        """Further pistons in the cell; their heights precede the coordinates of the machine's bodies."""
        return self.table.pistons

    @property
    def coordinate_count(self) -> int:
        """Number of coordinates: further pistons, and bodies of the machine."""
        return len(self.pistons) + len(self.table.chain)

    @property
    def masses(self) -> Float[np.ndarray, "b"]:
        """Masses [kg] of further pistons and machine bodies, without the grains and the first piston."""
        names = [other.name for other in self.pistons] + list(self.table.chain[:-1])
        masses = [self.table.masses[self.table.row_of_body(name)] for name in names]
        return np.array([*masses, *([self.table.carrying_mass] if self.table.chain else [])])

    def body_displacement_coefficients(
        self, name: str, size: int, piston: int | None
    ) -> Float[np.ndarray, "q"]:
        """Return the coefficients c in the displacement c . q of a body relative to the base."""
        result, first = np.zeros(size), size - self.coordinate_count
        if name == "base":
            return result
        if name in self.table.chain:
            result[first + len(self.pistons) + self.table.chain.index(name)] = 1.0
            return result
        result += self.cell_displacement_coefficients(size, piston)
        if name == "piston" and piston is not None:
            result[piston] += 1.0
        for index, piston_body in enumerate(self.pistons):
            result[first + index] += float(piston_body.name == name)
        return result

    def cell_displacement_coefficients(self, size: int, piston: int | None) -> Float[np.ndarray, "q"]:
        """Return the coefficients c in the displacement c . q of the cell relative to the base."""
        result = np.zeros(size)
        if self.table.chain:
            result[-1] = 1.0
        if self.free_cell_mass is not None:
            result[piston] = -1.0
        return result

    def _stretch_matrix(self, size: int, piston: int | None) -> Float[np.ndarray, "l q"]:
        springs = self.table.springs
        rows = [
            self.body_displacement_coefficients(link.upper, size, piston)
            - self.body_displacement_coefficients(link.lower, size, piston)
            for link in springs
        ]
        return np.array(rows).reshape(-1, size)

    def forces(self, q: Float[np.ndarray, "q"], piston: int | None) -> Float[np.ndarray, "q"]:
        """Return the forces of springs and stops, and the weights of further pistons [N]; q [m]."""
        springs, moved = self.table.springs, q.copy()
        if piston is not None:
            moved[piston] -= self.start
        rows = self._stretch_matrix(len(q), piston)
        pushes = [
            link.repulsive_force_at_stretch(stretch)
            for link, stretch in zip(springs, rows @ moved, strict=True)
        ]
        result = rows.T @ np.array(pushes).reshape(len(springs))
        first = len(q) - self.coordinate_count
        result[first : first + len(self.pistons)] -= self.gravity * np.array(
            [other.mass for other in self.pistons]
        )
        return np.asarray(result)

    def spring_or_dashpot_matrix(self, name: str, size: int, piston: int | None) -> Float[np.ndarray, "q q"]:
        """Matrix of all springs except stops; ``name`` is "stiffness" [N/m] or "damping" [N s/m]."""
        rows = self._stretch_matrix(size, piston)
        values = [getattr(link, name) * (link.gap is None) for link in self.table.springs]
        return np.asarray(rows.T @ (np.array(values).reshape(-1, 1) * rows))

    def damping_matrix(self, size: int, piston: int | None) -> Float[np.ndarray, "q q"]:
        """Damping matrix of the dashpots and of drag in the guides of further pistons [N s/m]."""
        result, first = self.spring_or_dashpot_matrix("damping", size, piston), size - self.coordinate_count
        for index, other in enumerate(self.pistons):
            result[first + index, first + index] += other.drag
        return result

    def mass_matrix(self, masses: Float[np.ndarray, "q"], piston: int | None) -> csc_matrix:
        """Mass matrix of all coordinates [kg]; ``masses`` holds grains (twice, for x and y) and piston."""
        from scipy.sparse import csc_matrix

        size = len(masses)
        count, inside = size - self.coordinate_count, size - len(self.table.chain)
        vertical, diagonal = np.zeros(size), masses.copy()
        vertical[(count - (piston is not None)) // 2 : inside] = 1.0
        diagonal[count:] = self.masses
        carried = csc_matrix((diagonal * vertical)[:, None])
        row = csc_matrix(self.cell_displacement_coefficients(size, piston)[None])
        total = float(diagonal @ vertical) + (self.free_cell_mass or 0.0)
        diagonal = csc_matrix((diagonal, (range(size), range(size))))
        return csc_matrix(diagonal + carried @ row + (carried @ row).T + total * (row.T @ row))


def machine_of_scene(scene: Scene) -> Machine | None:
    """Return the further pistons, bodies and springs of a scene; None if there are none."""
    host: Any = next((effect for effect in scene.effects.acting if effect.key == "host"), None)
    if host is None or not (host.bodies or host.pistons or host.springs):
        return None
    scales = Scales.from_grains(scene.grains)
    gravity = sum(
        effect.downward_acceleration(scales)
        for effect in scene.effects.acting
        if isinstance(effect, ForceEffect)
    )
    weight = host.cell_weight_on_piston(scene.grains, scales, gravity)
    return Machine(
        host.scene_bodies(scene.piston),
        gravity=gravity * scales.acceleration,
        start=0.0 if scene.piston is None else scene.piston.height,
        free_cell_mass=host.cell_mass,
        cell_weight_on_piston=None if weight is None else weight * scales.force,
    )


def mass_stiffness_and_damping_of_chain(
    host: Host,
) -> tuple[Float[np.ndarray, "b"], Float[np.ndarray, "b b"], Float[np.ndarray, "b b"]]:
    """Return masses [kg], spring matrix [N/m] and dashpot matrix [N s/m] of a machine without the bed."""
    alone = Host(mount=host.mount, cell_mass=host.cell_mass, bodies=host.bodies)
    machine = Machine(alone.scene_bodies(None), 0.0, 0.0, None, None)
    springs, dashpots = (
        machine.spring_or_dashpot_matrix(name, machine.coordinate_count, None)
        for name in ("stiffness", "damping")
    )
    return machine.masses, springs, dashpots


DISPLACEMENT = 5e-4
"""Largest displacement of a coordinate in a finite difference of forces [D]."""

OVERLAP_FRACTION, MINIMUM_DISPLACEMENT = 0.025, 1e-7
"""Displacement in a finite difference of contact forces, which are nonlinear. `OVERLAP_FRACTION` is the
displacement divided by the smallest overlap or gap of two grains; the relative error of the Hertzian
stiffness is then 1e-6. `MINIMUM_DISPLACEMENT` [D] is a lower bound of the displacement."""

FLOW = 1e-5
"""Duration [tau] of a motion under resistance alone, from which the decelerations are computed. At decay
rates of 5/tau, the decelerations have a rounding error of 1e-11, equal to the neglected second-order term."""

_FRICTION = ("friction", "wall_friction")

_ONE_STEP = StepSchedule(FLOW, FLOW, 1, 1, 1, 0)


class BedForces:
    """Forces and resistance of a scene's bed, without drive and dry friction, in SI."""

    def __init__(self, scene: Scene) -> None:
        self.machine: Machine | None = machine_of_scene(scene)
        bath: Any = getattr(scene.effects, "bath", None)
        self.bath_rate = 0.0 if bath is None else bath.rate
        self.scene = scene_without_drive_friction_and_bath(scene)
        self._run = RunState(plan(self.scene, threads=1))
        if self.machine is not None and self.machine.free_cell_mass is not None:
            self._reverse_gravity()
        # A step with one kick and no drift: without forces, it is the flow of all resistances.
        self._run.tables = self._run.tables._replace(kicks=np.ones(1), drifts=np.zeros(0))
        self.scales = self._run.system.scales
        self.length = self.scales.length
        self.grains = self._run.grain_constants.grains
        has_piston = has_free_piston(scene)
        self.piston = 2 * self.grains if has_piston else None
        self.pistons = 2 * self.grains + has_piston
        self.bodies = self.pistons + (0 if self.machine is None else len(self.machine.pistons))
        self.size = self.pistons + (0 if self.machine is None else self.machine.coordinate_count)
        self.weight = 0.0
        if has_piston:
            self.weight = self._run.grain_constants.piston_weight * self.scales.force
            if self.machine is not None and self.machine.cell_weight_on_piston is not None:
                self.weight = self.machine.cell_weight_on_piston

        self._displacement: tuple[np.ndarray | None, float] = (None, DISPLACEMENT)

    def _reverse_gravity(self) -> None:
        """Reverse gravity in the cell, because the machine carries the piston instead of the cell."""
        constants = self._run.grain_constants
        laws = tuple(
            law._replace(pull=-law.pull) if isinstance(law, GravityLaw) else law
            for law in constants.acting.laws
        )
        self._run.grain_constants = constants._replace(acting=constants.acting._replace(laws=laws))

    @property
    def has_force_jump_at_cut_off(self) -> bool:
        """True if pair forces are cut off at a radius at which they are not zero."""
        acting = self._run.grain_constants.acting
        ends = (acting.cut, acting.listing, acting.nearest)
        return bool(acting.dipole) and acting.far is None and any(end is not None for end in ends)

    @property
    def _vertical_coordinates(self) -> slice:
        return slice(self.grains, 2 * self.grains)

    def coordinates(self, positions: Float[np.ndarray, "n 2"], height: Heights) -> Float[np.ndarray, "q"]:
        """Coordinates of grains, piston and further pistons, with the machine at rest [m]."""
        result = np.zeros(self.size)
        result[: self.grains], result[self._vertical_coordinates] = positions[:, 0], positions[:, 1]
        heights = np.atleast_1d(0.0 if height is None else height)
        self._height = float(heights[0])
        if self.piston is not None:
            result[self.piston] = self._height
        result[self.pistons : self.bodies] = heights[1:] if len(heights) > 1 else 0.0
        return result

    def positions(self, q: Float[np.ndarray, "q"]) -> Float[np.ndarray, "n 2"]:
        """Positions of the grains [m]."""
        return np.stack([q[: self.grains], q[self._vertical_coordinates]], axis=1)

    def piston_height(self, q: Float[np.ndarray, "q"]) -> float:
        """Height of the piston [m]; the prescribed height if the piston is not free."""
        return self._height if self.piston is None else float(q[self.piston])

    def _compute_forces_and_record(self, q: Float[np.ndarray, "q"]) -> Float[np.ndarray, "columns"]:
        """Compute all forces by the simulation loop, and return the row that it records."""
        state, length = self._run.state, self.length
        state.x[: self.grains] = q[: self.grains] / length
        state.y[: self.grains] = q[self._vertical_coordinates] / length
        state.piston[HEIGHT] = self.piston_height(q) / length
        state.bodies[PISTON + 1 :, HEIGHT] = q[self.pistons : self.bodies] / length
        try:
            with report_arithmetic_errors_as(_misplaced_grain_error):
                return self._run.present_record("")
        except RunError:
            raise _misplaced_grain_error() from None

    def forces(self, q: Float[np.ndarray, "q"]) -> Float[np.ndarray, "q"]:
        """Conservative forces on all coordinates [N]; q [m]."""
        row = self._compute_forces_and_record(q)
        state, n = self._run.state, self.grains
        fx, fy = force_components_with_far_field(state)
        result = np.zeros(self.size)
        result[:n], result[self._vertical_coordinates] = (
            fx[:n] * self.scales.force,
            fy[:n] * self.scales.force,
        )
        if self.piston is not None:
            result[self.piston] = row[columns.UPWARD] * self.scales.force - self.weight
        if self.machine is not None:
            result += self.machine.forces(q, self.piston)
            for side, force in zip(self._run.grain_constants.acting.sides, state.wall_forces, strict=True):
                if side.body > PISTON:
                    result[self.pistons + side.body - PISTON - 1] -= side.ny * force * self.scales.force
        return result

    def stiffness_times(
        self, q: Float[np.ndarray, "q"], direction: Float[np.ndarray, "q"]
    ) -> Float[np.ndarray, "q"]:
        """Multiply the stiffness matrix -dF/dq [N/m] at q [m] by a vector."""
        return -directional_derivative(
            self.forces, q, direction, self.finite_difference_displacement(q) * self.length
        )

    def finite_difference_displacement(self, q: Float[np.ndarray, "q"]) -> float:
        """Return the displacement in a finite difference of forces [D], smaller if grains almost touch."""
        grains = self.scene.grains
        if self.scene.effects.contact is None and grains.magnets != "cylinders":
            return DISPLACEMENT
        if self._displacement[0] is not q:
            smallest = OVERLAP_FRACTION * self._smallest_overlap_or_gap(q) / self.length
            self._displacement = q, min(DISPLACEMENT, max(smallest, MINIMUM_DISPLACEMENT))
        return self._displacement[1]

    def _smallest_overlap_or_gap(self, q: Float[np.ndarray, "q"]) -> float:
        """Return the smallest absolute value of an overlap or gap between two grains [m]."""
        from scipy.spatial import cKDTree

        cell, radius, points = self.scene.cell, 0.5 * self.scene.grains.diameters(), self.positions(q)
        tree = cKDTree(cell.wrap_positions(points), boxsize=cell.periods)
        i, j = tree.query_pairs(2.1 * float(radius.max()), output_type="ndarray").T
        apart = cell.nearest_image_displacements(points[i] - points[j])
        gaps = np.abs(np.hypot(*apart.T) - radius[i] - radius[j])
        return float(gaps.min(initial=np.inf))

    def damping_matrix_times(
        self, q: Float[np.ndarray, "q"], velocities: Float[np.ndarray, "q"]
    ) -> Float[np.ndarray, "q"]:
        """Multiply the damping matrix at q [m] by velocities [m/s], which gives minus the resistance [N]."""
        self._compute_forces_and_record(q)
        run, n, scales = self._run, self.grains, self.scales
        state = run.state
        far = state.far_forces
        for forces in (state.fx, state.fy, *(() if far is None else (far.fx, far.fy))):
            forces[:] = 0.0
        largest = float(np.abs(velocities).max(initial=0.0)) or 1.0
        kicked = []
        for sign in (1.0, -1.0):
            state.vx[:n], state.vy[:n] = (
                velocities[:n] / largest,
                velocities[self._vertical_coordinates] / largest,
            )
            schedule = _ONE_STEP._replace(length=sign * FLOW, h=sign * FLOW)
            run.call_engine(NO_TICKS._replace(ticks=1), schedule, NO_STOP_CRITERIA)
            kicked.append(np.concatenate([state.vx[:n], state.vy[:n]]))
        state.vx[:], state.vy[:], state.bodies[:, SPEED] = 0.0, 0.0, 0.0
        rates = (kicked[1] - kicked[0]) * (largest / (2.0 * FLOW * scales.time))
        result = np.zeros(self.size)
        result[: 2 * n] = self.masses()[: 2 * n] * (rates + self.bath_rate * velocities[: 2 * n])
        if self.piston is not None and self.scene.piston is not None:
            result[self.piston] = self.scene.piston.drag * velocities[self.piston]
        if self.machine is not None:
            result += self.machine.damping_matrix(self.size, self.piston) @ velocities
        return result

    def masses(self) -> Float[np.ndarray, "q"]:
        """Masses of the grains (twice, for x and y) and of the piston, and zeros for other bodies [kg]."""
        grains = self.scene.grains.masses()
        result = np.zeros(self.size)
        result[: 2 * self.grains] = np.tile(grains, 2)
        if self.piston is not None and self.scene.piston is not None:
            result[self.piston] = self.scene.piston.mass
        return result

    def cell_displacement_coefficients_and_uplift(
        self,
    ) -> tuple[Float[np.ndarray, "q"], Float[np.ndarray, "q"]]:
        """Return c in the cell's displacement c . q, and the change of q if all bodies rise by 1 m."""
        frame, uplift = np.zeros(self.size), np.zeros(self.size)
        if self.machine is None or not self.machine.table.chain:
            uplift[self.grains : self.bodies] = 1.0
        else:
            frame[:] = self.machine.cell_displacement_coefficients(self.size, self.piston)
            uplift[self.bodies :] = 1.0
        return frame, uplift

    def mass_matrix(self) -> csc_matrix:
        """Mass matrix [kg]; a machine that carries the cell couples all vertical motions."""
        from scipy.sparse import csc_matrix

        masses, indices = self.masses(), range(self.size)
        if self.machine is None:
            return csc_matrix((masses, (indices, indices)))
        return self.machine.mass_matrix(masses, self.piston)


def directional_derivative(
    function: Callable[[np.ndarray], Any],
    at: Float[np.ndarray, "q"],
    direction: Float[np.ndarray, "q"],
    largest: float,
) -> Any:
    """Differentiate along a direction to fourth order; ``largest`` is the maximum displacement."""
    size = float(np.abs(direction).max(initial=0.0))
    if size == 0.0:
        return 0.0 * function(at)
    step = largest / size
    near = function(at + step * direction) - function(at - step * direction)
    far = function(at + 2.0 * step * direction) - function(at - 2.0 * step * direction)
    return (8.0 * near - far) / (12.0 * step)


def scene_without_drive_friction_and_bath(scene: Scene) -> Scene:
    """Remove cell drive, dry friction and heat bath from a scene, so that it has a single equilibrium."""
    taken: dict[str, Any] = {
        f"effects.{effect.key}": None
        for effect in scene.effects.acting
        if effect.key in ("shaking", "bath", "host", *_FRICTION)
    }
    if scene.piston is not None and scene.piston.friction:
        taken["piston.friction"] = 0.0
    if scene.effects.host is not None and scene.effects.host.pistons:
        pistons = [
            {"name": other.name, "mass": other.mass, "side": other.side}
            for other in scene.effects.host.pistons
        ]
        taken["effects.host"] = {"mount": "base", "pistons": pistons}
    return scene.replace(**taken) if taken else scene


def has_free_piston(scene: Scene) -> bool:
    """Return whether a bed supports a piston that is free to move."""
    return scene.piston is not None and scene.piston.mass is not None and scene.has_piston_wall


def check_free_piston(scene: Scene) -> None:
    """Raise an error if a scene has no free piston."""
    if not has_free_piston(scene):
        wall = piston_wall_key(scene.cell.lines)
        raise InputError(f"the scene has no free piston; give piston.mass and {wall}")


def has_dry_friction(scene: Scene) -> bool:
    """Return whether dry friction acts on grains or piston."""
    friction = 0.0 if scene.piston is None else scene.piston.friction
    return friction > 0.0 or any(effect.key in _FRICTION for effect in scene.effects.acting)


def _misplaced_grain_error() -> InputError:
    return InputError(
        "a grain is outside the cell or at the position of another grain; start from a settled state"
    )


def scene_with_scaled_value(scene: Scene, key: str, factor: float) -> Scene:
    """Multiply the value at a dotted key of a scene; the value may be derived from magnets or liquids."""
    value = find_value(scene, key)
    if not isinstance(value, float):
        raise InputError(
            f"{quote(key)} is not the key of a number in the scene {quote(scene.name)}; use another key"
        )
    return scene_with_value(scene, key, value * factor)


def scene_with_value(scene: Scene, key: str, value: float) -> Scene:
    """Change the value at a dotted key; a diameter also changes the pitch of walls made of magnets."""
    changes = {key: value}
    before, walls = find_value(scene, key), scene.effects.walls
    if key.endswith(".diameter") and walls is not None:
        named = [wall for wall in walls.sides_with_walls if wall[0] not in walls.unnamed]
        changes |= {f"effects.walls.{side}.pitch": value for side, wall in named if wall.pitch == before}
    return scene.replace(**changes)
