"""Laws of a user's own as the loop takes them: loops over grains and pairs that hold functions."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numba
from numba.extending import overload

from granular.compiled import Array, compiled
from granular.compiled.hook_calls import OPTIONS
from granular.effects.custom_functions import DEFINITIONS, CustomDefinition, Grain
from granular.kernel_data.constants import Constants, relative_moments
from granular.kernel_data.state import LOSSES, WORK, Bed, State
from granular.pairs.cell_list import CellList, cell_list_workspace, find_partners_of_grain, sort_into_cells
from granular.pairs.grain_arrays import value_or_one

if TYPE_CHECKING:
    from jaxtyping import Float


class CustomLaw(NamedTuple):
    """An own effect as the kernels take it."""

    kind: Any
    values: tuple[float, ...]  # parameters in natural units
    reach: float  # pairs from this distance on do nothing [D]; infinite: all pairs count
    factor: Float[Array, "m"] | None  # energy and force of each grain are multiplied by it

    def workspace(self, size: int, count: int) -> CellList | None:
        """Make cells for the search of grains within reach."""
        pairs = "pair_force" in DEFINITIONS[self.kind.name].functions
        return cell_list_workspace(count) if pairs and math.isfinite(self.reach) else None

    @staticmethod
    @compiled(inline=True)
    def add_forces(law: CustomLaw, workspace: CellList | None, index: int, bed: Bed, time: float) -> int:
        """Add the forces on the grains, and between them, by the user's functions [F*]; time [tau]."""
        state, constants = bed.state, bed.constants
        _grain_forces(law.kind, law, state, constants, time)
        return _pair_forces(law.kind, law, workspace, state, constants)

    @staticmethod
    @compiled(inline=True)
    def measure_energy_and_stiffness(
        law: CustomLaw,
        workspace: CellList | None,
        index: int,
        bed: Bed,
        time: float,
        stiffness: Float[Array, "m"],
        energies: Float[Array, "laws"],
    ) -> int:
        """Enter the energies by the user's functions [F* D], and add their stiffness [1/tau^2]."""
        state, constants = bed.state, bed.constants
        energies[index] = _grain_energy(law.kind, law, state, constants, time, stiffness)
        energies[index] += _pair_energy(law.kind, law, workspace, state, constants, stiffness)
        return 0

    @staticmethod
    @compiled(inline=True)
    def damp_velocities(
        law: CustomLaw, workspace: CellList | None, index: int, dt: float, bed: Bed, opens_step: bool
    ) -> int:
        """Apply the user's ``flow`` to the velocity of each grain; enter the energy lost; dt [tau]."""
        _flow(law.kind, law, LOSSES + index, dt, bed.state, bed.constants)
        return 0

    @staticmethod
    @compiled(inline=True)
    def record_external_work(
        law: CustomLaw, workspace: CellList | None, index: int, dt: float, bed: Bed, time: float
    ) -> int:
        """Enter dt [tau] times the user's ``power`` of all grains as work from outside [F* D]."""
        state, constants = bed.state, bed.constants
        _work(law.kind, law, dt, state, constants, time)
        return 0


@compiled(inline=True)
def make_grain(
    state: State, masses: Float[Array, "m"] | None, moments: Float[Array, "m"] | None, i: int
) -> Grain:
    """Grain as the user's functions see it: x, y [D], and mass and moment over the first species'."""
    return Grain(state.x[i], state.y[i], value_or_one(masses, i), value_or_one(moments, i))


Loop = Callable[..., Any]


def dispatch_by_kind(make: Callable[[CustomDefinition], Loop]) -> Loop:
    """Make a kernel ``(kind, *rest)`` whose code the kind chooses when it is compiled."""

    def call(kind: Any, *rest: Any) -> Any:
        return make(DEFINITIONS[kind.name])(kind, *rest)

    def choose(kind: Any, *rest: Any) -> Loop:
        return make(DEFINITIONS[kind.name])

    if not numba.config.DISABLE_JIT:
        overload(call, jit_options=OPTIONS, strict=False)(choose)
    return call


def _return_zero(*arguments: Any) -> float:
    return 0.0


if not numba.config.DISABLE_JIT:
    _return_zero = numba.njit(**OPTIONS)(_return_zero)


def _make_grain_forces(definition: CustomDefinition) -> Loop:
    force, values_of = definition.kernels.get("force"), definition.parameters
    if force is None:
        return lambda kind, law, state, constants, time: None

    def add(kind: Any, law: CustomLaw, state: State, constants: Constants, time: float) -> None:
        p = values_of(*law.values)
        masses, moments = constants.masses, relative_moments(constants)
        for i in range(constants.grains):
            fx, fy = force(p, make_grain(state, masses, moments, i), time)
            state.fx[i] += value_or_one(law.factor, i) * fx
            state.fy[i] += value_or_one(law.factor, i) * fy

    return add


def _make_grain_energy(definition: CustomDefinition) -> Loop:
    energy, values_of = definition.kernels.get("energy"), definition.parameters
    stiffness: Loop = definition.kernels.get("stiffness", _return_zero)
    if energy is None:
        return lambda kind, law, state, constants, time, slopes: 0.0

    def measure(
        kind: Any, law: CustomLaw, state: State, constants: Constants, time: float, slopes: Array
    ) -> float:
        p, total = values_of(*law.values), 0.0
        masses, moments = constants.masses, relative_moments(constants)
        for i in range(constants.grains):
            grain, factor = make_grain(state, masses, moments, i), value_or_one(law.factor, i)
            total += factor * energy(p, grain, time)
            slopes[i] += abs(factor * stiffness(p, grain, time)) / grain.mass
        return total

    return measure


def _make_external_work(definition: CustomDefinition) -> Loop:
    power, values_of = definition.kernels.get("power"), definition.parameters
    if power is None:
        return lambda kind, law, dt, state, constants, time: None

    def work(kind: Any, law: CustomLaw, dt: float, state: State, constants: Constants, time: float) -> None:
        p, total = values_of(*law.values), 0.0
        masses, moments = constants.masses, relative_moments(constants)
        for i in range(constants.grains):
            total += value_or_one(law.factor, i) * power(p, make_grain(state, masses, moments, i), time)
        state.ledger[WORK] += dt * total

    return work


def _make_flow(definition: CustomDefinition) -> Loop:
    flow, values_of = definition.kernels.get("flow"), definition.parameters
    if flow is None:
        return lambda kind, law, entry, dt, state, constants: None

    def damp(kind: Any, law: CustomLaw, entry: int, dt: float, state: State, constants: Constants) -> None:
        p, lost = values_of(*law.values), 0.0
        masses, moments = constants.masses, relative_moments(constants)
        for i in range(constants.grains):
            grain, vx, vy = make_grain(state, masses, moments, i), state.vx[i], state.vy[i]
            wx, wy = flow(p, grain, vx, vy, dt)
            state.vx[i], state.vy[i] = wx, wy
            lost += 0.5 * grain.mass * ((vx - wx) * (vx + wx) + (vy - wy) * (vy + wy))
        state.ledger[entry] += lost

    return damp


@compiled
def _sort_grains_into_cells(law: CustomLaw, cells: CellList | None, state: State, count: int) -> bool:
    """Sort the grains, where pairs end; False where a position is no number."""
    return True if cells is None else sort_into_cells(cells, state.x, state.y, count, law.reach)


@compiled
def _count_partners(law: CustomLaw, cells: CellList | None, state: State, i: int, count: int) -> int:
    """Return the number of a grain's partners: those within reach, or all that follow it."""
    if cells is None:
        return count - 1 - i
    return find_partners_of_grain(cells, state.x, state.y, i, law.reach)


@compiled
def _partner_index(cells: CellList | None, i: int, k: int) -> int:
    return i + 1 + k if cells is None else cells.partners[k]


def _make_pair_forces(definition: CustomDefinition) -> Loop:
    force, values_of = definition.kernels.get("pair_force"), definition.parameters
    if force is None:
        return lambda kind, law, cells, state, constants: 0

    def add(kind: Any, law: CustomLaw, cells: CellList | None, state: State, constants: Constants) -> int:
        p, count = values_of(*law.values), constants.grains
        masses, moments = constants.masses, relative_moments(constants)
        if not _sort_grains_into_cells(law, cells, state, count):
            return 1
        for i in range(count):
            first = make_grain(state, masses, moments, i)
            for k in range(_count_partners(law, cells, state, i, count)):
                j = _partner_index(cells, i, k)
                dx, dy = state.x[i] - state.x[j], state.y[i] - state.y[j]
                r = math.sqrt(dx * dx + dy * dy)
                if r < law.reach:
                    ratio = force(p, r, first, make_grain(state, masses, moments, j)) / r
                    state.fx[i] += ratio * dx
                    state.fy[i] += ratio * dy
                    state.fx[j] -= ratio * dx
                    state.fy[j] -= ratio * dy
        return 0

    return add


def _make_pair_energy(definition: CustomDefinition) -> Loop:
    energy, values_of = definition.kernels.get("pair_energy"), definition.parameters
    stiffness: Loop = definition.kernels.get("pair_stiffness", _return_zero)
    if energy is None:
        return lambda kind, law, cells, state, constants, slopes: 0.0

    def measure(
        kind: Any, law: CustomLaw, cells: CellList | None, state: State, constants: Constants, slopes: Array
    ) -> float:
        p, count, total = values_of(*law.values), constants.grains, 0.0
        masses, moments = constants.masses, relative_moments(constants)
        if not _sort_grains_into_cells(law, cells, state, count):
            return math.nan
        for i in range(count):
            first = make_grain(state, masses, moments, i)
            for k in range(_count_partners(law, cells, state, i, count)):
                j = _partner_index(cells, i, k)
                dx, dy = state.x[i] - state.x[j], state.y[i] - state.y[j]
                r = math.sqrt(dx * dx + dy * dy)
                if r < law.reach:
                    second = make_grain(state, masses, moments, j)
                    total += energy(p, r, first, second)
                    # Twice: Gershgorin's row sum has the pair's block on the diagonal and beside it.
                    slope = 2.0 * abs(stiffness(p, r, first, second))
                    slopes[i] += slope / first.mass
                    slopes[j] += slope / second.mass
        return total

    return measure


_grain_forces = dispatch_by_kind(_make_grain_forces)
_grain_energy = dispatch_by_kind(_make_grain_energy)
_work = dispatch_by_kind(_make_external_work)
_flow = dispatch_by_kind(_make_flow)
_pair_forces = dispatch_by_kind(_make_pair_forces)
_pair_energy = dispatch_by_kind(_make_pair_energy)


NEAREST, FARTHEST = 1e-4, 1e3
"""Distances [D] between which a grain's turning point is looked for."""


class CustomWallLaw(NamedTuple):
    """An own law of a wall as the kernels take it."""

    kind: Any
    values: tuple[float, ...]

    @staticmethod
    @compiled(inline=True)
    def force(law: CustomWallLaw, w: float) -> float:
        """Force away from the wall on a grain of the first species, by the user's function [F*]; w [D]."""
        return _wall_force(law.kind, law.values, w)

    @staticmethod
    @compiled(inline=True)
    def energy(law: CustomWallLaw, w: float) -> float:
        """Energy of a grain of the first species at the wall, by the user's function [F* D]; w [D]."""
        return _wall_energy(law.kind, law.values, w)

    @staticmethod
    @compiled(inline=True)
    def stiffness(law: CustomWallLaw, w: float) -> float:
        """Minus the slope of the force at the wall, by the user's function [F*/D]; w [D]."""
        return _wall_stiffness(law.kind, law.values, w)

    @staticmethod
    @compiled
    def turning_point_stiffness(law: CustomWallLaw, speed: float) -> float:
        """Stiffness where a grain turns, by bisection in log(distance) [1/tau^2]; speed [D/tau]."""
        near, far = math.log(NEAREST), math.log(FARTHEST)
        # log(1e3/1e-4)/2^60 is below the rounding of the logarithm.
        for _ in range(60):
            middle = 0.5 * (near + far)
            if _wall_energy(law.kind, law.values, math.exp(middle)) > 0.5 * speed * speed:
                near = middle
            else:
                far = middle
        return abs(_wall_stiffness(law.kind, law.values, math.exp(near)))


def _make_wall_function(name: str) -> Any:
    def make(definition: CustomDefinition) -> Any:
        function, values_of = definition.kernels[name], definition.parameters

        def call(kind: Any, values: tuple[float, ...], w: float) -> Any:
            return function(values_of(*values), w)

        return call

    return dispatch_by_kind(make)


_wall_force, _wall_energy, _wall_stiffness = (
    _make_wall_function(name) for name in ("force", "energy", "stiffness")
)
