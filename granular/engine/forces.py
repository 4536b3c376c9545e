"""All forces on the grains, and the energies and stiffness that go with them."""

from __future__ import annotations

from granular.compiled import Array, compiled
from granular.effects.dipole import ENERGY
from granular.effects.gravity import add_weight, weight_energy
from granular.effects.walls import add_wall_forces, measure_walls
from granular.engine.state import Measurement, State
from granular.engine.system import Constants
from granular.pairs.direct import direct_sum
from granular.pairs.vector import lane_sum


@compiled
def _pair_forces(
    dipole: bool | None,
    state: State,
    charge: Array | None,
    stiffness: Array | None,
    extremes: Array | None,
    threaded: bool | None,
) -> None:
    if dipole is None:
        state.fx[:] = 0.0
        state.fy[:] = 0.0
        if stiffness is not None:
            stiffness[:] = 0.0
        if extremes is not None:
            extremes[:] = 0.0
    else:
        direct_sum(
            state.x, state.y, state.fx, state.fy,
            charge, stiffness, extremes, None, None, state.buffers, threaded,
        )  # fmt: skip


@compiled
def _other_forces(state: State, constants: Constants) -> int:
    acting, count, charge = constants.acting, constants.grains, constants.charge
    add_weight(acting.gravity, count, charge, state.fy)
    return add_wall_forces(
        acting.walls, count, charge, state.x, state.y, state.fx, state.fy,
        constants.width, state.piston[0], state.push, state.totals,
    )  # fmt: skip


@compiled
def compute_forces(state: State, constants: Constants) -> int:
    """Overwrite the forces on the grains and the walls.

    Returns
    -------
    int
        Zero while every grain is where it can be (see `add_wall_forces`).
    """
    _pair_forces(constants.acting.dipole, state, constants.charge, None, None, constants.threaded)
    return _other_forces(state, constants)


@compiled
def measure_forces(state: State, constants: Constants, measurement: Measurement) -> int:
    """`compute_forces`, with the sums that `energies` and `stiffest` need, in the same pass."""
    _pair_forces(
        constants.acting.dipole, state, constants.charge,
        measurement.stiffness, measurement.extremes, constants.threaded,
    )  # fmt: skip
    return _other_forces(state, constants)


@compiled
def kinetic_energy(state: State, constants: Constants) -> tuple[float, float]:
    """Kinetic energy of the grains [F* D], and the square of the greatest speed."""
    fastest = 0.0
    for i in range(constants.grains):
        square = state.vx[i] * state.vx[i] + state.vy[i] * state.vy[i]
        fastest = max(fastest, square)
        state.push[i] = square
    return 0.5 * _mass_sum(state, constants.charge), fastest


@compiled
def _mass_sum(state: State, charge: Array | None) -> float:
    if charge is not None:
        for i in range(charge.size):
            state.push[i] *= charge[i]
    return lane_sum(state.push)


@compiled
def potential_energies(
    state: State, constants: Constants, measurement: Measurement
) -> tuple[float, float, float]:
    """Energies of the pairs, at the walls, and of the grains' weight [F* D].

    Needs a measuring pass at the same positions; completes its stiffness to a bound of the
    square of the highest angular frequency of each grain: half a row sum of Gershgorin's theorem
    for the pairs (a pair's stiffness 3 q_i q_j / r^5 enters the row of i twice), and the walls'.
    """
    stiffness = measurement.stiffness
    for i in range(constants.grains):
        stiffness[i] *= 6.0
    walls = measure_walls(
        constants.acting.walls, constants.grains, constants.charge, state.x, state.y,
        constants.width, state.piston[0], stiffness, state.push,
    )  # fmt: skip
    weight = weight_energy(constants.acting.gravity, constants.grains, constants.charge, state.y)
    return ENERGY * measurement.extremes[0], walls, weight
