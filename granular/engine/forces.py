"""All forces on the grains, and the energies and stiffness that go with them."""

from __future__ import annotations

import math

from granular.compiled import Array, compiled, entry
from granular.effects import contact
from granular.effects.contact import ContactLaw
from granular.effects.dipole import ENERGY
from granular.effects.friction import FrictionLaw
from granular.effects.gravity import add_weight, weight_energy
from granular.effects.shaking import Swing, acceleration, add_inertia, mass_moment
from granular.effects.walls import add_wall_forces, measure_walls
from granular.engine.far import add_far_field, far_energy, find_far_field, refresh_far_field
from granular.engine.state import HEIGHT, Measurement, State
from granular.engine.system import Constants, moments_of
from granular.pairs.cells import ClosePairs, find_close_pairs
from granular.pairs.direct import direct_sum
from granular.pairs.stripes import CutOff, cut_sum
from granular.pairs.vector import lane_sum
from granular.pairs.verlet_list import Listing, list_sum


@compiled(inline=True)
def _magnetic_forces(
    cut: CutOff | None, listing: Listing | None, state: State, constants: Constants,
    stiffness: Array | None, extremes: Array | None, load: Array | None, weight: Array | None,
) -> None:  # fmt: skip
    if cut is None and listing is None:
        direct_sum(
            state.x, state.y, state.fx, state.fy, moments_of(constants),
            stiffness, extremes, load, weight, state.buffers, constants.threaded,
        )  # fmt: skip
    if cut is not None:
        assert state.stripes is not None
        cut_sum(
            state.stripes, cut.radius, cut.smooth, constants.threaded, constants.grains,
            state.x, state.y, state.fx, state.fy, moments_of(constants),
            stiffness, extremes, load, weight,
        )  # fmt: skip
    if listing is not None:
        assert state.verlet_list is not None
        list_sum(
            state.verlet_list, listing, constants.grains, state.x, state.y, state.fx, state.fy,
            moments_of(constants), stiffness, extremes, load, weight,
        )  # fmt: skip


@compiled(inline=True)
def _pair_forces(
    dipole: bool | None, friction: FrictionLaw | None, state: State, constants: Constants,
    stiffness: Array | None, extremes: Array | None,
) -> None:  # fmt: skip
    if dipole is None:
        state.fx[:] = 0.0
        state.fy[:] = 0.0
        if stiffness is not None:
            stiffness[:] = 0.0
        if extremes is not None:
            extremes[:] = 0.0
    elif friction is None:
        _magnetic_forces(
            constants.acting.cut, constants.acting.listing, state, constants,
            stiffness, extremes, None, None,
        )  # fmt: skip
    else:
        _magnetic_forces(
            constants.acting.cut, constants.acting.listing, state, constants,
            stiffness, extremes, state.load, friction.weight,
        )  # fmt: skip


@compiled
def _contact_forces(
    law: ContactLaw | None, close_pairs: ClosePairs | None, state: State, constants: Constants
) -> int:
    """Add the forces of the grains in contact; 1 where there was no room for them."""
    if law is not None and close_pairs is not None:
        find_close_pairs(close_pairs, state.x, state.y, constants.grains, law.widest)
        for p in range(close_pairs.filled[0]):
            i, j = close_pairs.first[p], close_pairs.second[p]
            dx, dy = state.x[i] - state.x[j], state.y[i] - state.y[j]
            r = math.sqrt(dx * dx + dy * dy)
            overlap = law.radius[i] + law.radius[j] - r
            if overlap > 0.0:
                k = contact.spring(law, law.radius[i], law.radius[j])
                ratio = contact.force(k, overlap) / r
                state.fx[i] += ratio * dx
                state.fy[i] += ratio * dy
                state.fx[j] -= ratio * dx
                state.fy[j] -= ratio * dy
        return int(close_pairs.filled[0] < 0)
    return 0


@compiled(inline=True)
def _other_forces(state: State, constants: Constants, time: float) -> int:
    acting, count = constants.acting, constants.grains
    add_weight(acting.gravity, count, constants.masses, state.fy)
    add_inertia(acting.shaking, time, count, constants.masses, state.fx, state.fy)
    crowded = _contact_forces(acting.contact, state.close_pairs, state, constants)
    return crowded + add_wall_forces(
        acting.walls, count, moments_of(constants), state.x, state.y, state.fx, state.fy,
        constants.width, state.piston[HEIGHT], state.scratch, state.slab_scratch, state.wall_forces,
    )  # fmt: skip


@entry(inline=True)
def compute_forces(state: State, constants: Constants, time: float) -> int:
    """Overwrite the forces on the grains and the walls, at a time [tau].

    Returns
    -------
    int
        Zero while every grain is where it can be (see `add_wall_forces`).
    """
    acting = constants.acting
    _pair_forces(acting.dipole, acting.friction, state, constants, None, None)
    crowded = refresh_far_field(state.far_forces, state, constants)
    add_far_field(state.far_forces, state, constants.grains)
    return crowded + _other_forces(state, constants, time)


@entry
def measure_forces(
    state: State, constants: Constants, time: float, measurement: Measurement
) -> int:
    """`compute_forces`, with the sums that `potential_energies` needs, in the same pass."""
    acting = constants.acting
    _pair_forces(
        acting.dipole, acting.friction, state, constants,
        measurement.stiffness, measurement.extremes,
    )  # fmt: skip
    crowded = find_far_field(state.far_forces, state, constants)
    add_far_field(state.far_forces, state, constants.grains)
    return crowded + _other_forces(state, constants, time)


@entry
def kinetic_energy(state: State, constants: Constants) -> tuple[float, float]:
    """Kinetic energy of the grains [F* D], and the square of the greatest speed."""
    fastest = 0.0
    for i in range(constants.grains):
        square = state.vx[i] * state.vx[i] + state.vy[i] * state.vy[i]
        fastest = max(fastest, square)
        state.scratch[i] = square
    return 0.5 * _mass_sum(state, constants.masses), fastest


@compiled
def _mass_sum(state: State, masses: Array | None) -> float:
    """Sum of the masses times what is in the scratch."""
    if masses is not None:
        for i in range(masses.size):
            state.scratch[i] *= masses[i]
    return lane_sum(state.scratch)


@compiled
def _contact_energy(
    law: ContactLaw | None,
    close_pairs: ClosePairs | None,
    state: State,
    masses: Array | None,
    stiffness: Array,
) -> float:
    total = 0.0
    if law is not None and close_pairs is not None:
        for p in range(close_pairs.filled[0]):
            i, j = close_pairs.first[p], close_pairs.second[p]
            dx, dy = state.x[i] - state.x[j], state.y[i] - state.y[j]
            overlap = law.radius[i] + law.radius[j] - math.sqrt(dx * dx + dy * dy)
            if overlap > 0.0:
                k = contact.spring(law, law.radius[i], law.radius[j])
                total += contact.energy(k, overlap)
                slope = 2.0 * contact.stiffness(k, overlap)
                stiffness[i] += slope if masses is None else slope / masses[i]
                stiffness[j] += slope if masses is None else slope / masses[j]
    return total


@compiled
def _inertia_energy(swing: Swing | None, time: float, state: State, constants: Constants) -> float:
    if swing is None:
        return 0.0
    ax, ay = acceleration(swing, time)
    mx, my = mass_moment(constants.grains, constants.masses, state.x, state.y)
    return -(ax * mx + ay * my)


@entry
def potential_energies(
    state: State, constants: Constants, time: float, measurement: Measurement
) -> tuple[float, float, float, float]:
    """Energies of pairs, walls, weight (and inertia), and contacts [F* D].

    Needs a measuring pass at the same positions; completes its stiffness to a bound of the
    square of the highest angular frequency of each grain: half a row sum of Gershgorin's theorem
    for the pairs (a pair's stiffness 3 q_i q_j / r^5 enters the row of i twice), and the walls'.
    """
    acting, count = constants.acting, constants.grains
    stiffness = measurement.stiffness
    for i in range(count):
        stiffness[i] *= 6.0
    walls = measure_walls(
        acting.walls, count, moments_of(constants), state.x, state.y,
        constants.width, state.piston[HEIGHT], stiffness, state.scratch,
    )  # fmt: skip
    contacts = _contact_energy(
        acting.contact, state.close_pairs, state, constants.masses, stiffness
    )
    weight = weight_energy(acting.gravity, count, constants.masses, state.y)
    weight += _inertia_energy(acting.shaking, time, state, constants)
    pairs = ENERGY * measurement.extremes[0] + far_energy(state.far_forces)
    return pairs, walls, weight, contacts
