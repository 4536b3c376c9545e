"""All forces on the grains, and the energies and stiffness that go with them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from granular.compiled import Array, compiled, entry
from granular.compiled.by_reference import by_reference
from granular.compiled.hook_calls import sum_of_hooks
from granular.engine.far_field_forces import add_far_field, compute_far_field, far_energy, refresh_far_field
from granular.kernel_data.constants import Constants, multiply_by_moment_over_mass, pair_stiffness_bound
from granular.kernel_data.state import Bed, Measurement, State, grain_arrays_of_bed
from granular.pairs.cut_off_sum import cut_off_sum
from granular.pairs.dipole_law import ENERGY
from granular.pairs.direct_sum import direct_sum
from granular.pairs.direct_vector_loops import reproducible_sum
from granular.pairs.grain_arrays import GrainArrays, array_if_wanted, clear_sums
from granular.pairs.near_law import add_near_forces, add_near_loads, measure_near_part
from granular.pairs.stripes import CutOffSettings
from granular.pairs.verlet_list import VerletSettings, verlet_list_sum

if TYPE_CHECKING:
    from jaxtyping import Float


@compiled(inline=True)
def _sum_magnetic_forces(
    cut: CutOffSettings | None, listing: VerletSettings | None, bed: Bed, arrays: GrainArrays
) -> None:
    state, constants = bed.state, bed.constants
    grains, threaded = constants.grains, constants.threaded
    if cut is None and listing is None:
        direct_sum(arrays, state.buffers, threaded, constants.acting.nearest)
    if cut is not None:
        assert state.stripes is not None
        cut_off_sum(state.stripes, cut.radius, cut.smooth, threaded, grains, arrays)
    if listing is not None:
        assert state.verlet_list is not None
        verlet_list_sum(state.verlet_list, grains, arrays)


@compiled(inline=True)
def _compute_pair_forces(
    dipole: bool | None, bed: Bed, stiffness: Array | None, energy_and_closest: Array | None
) -> int:
    """Compute the magnetic forces; the number of pairs that are where none can be."""
    state, constants = bed.state, bed.constants
    weight, near, grains = constants.acting.weight, constants.acting.near, constants.grains
    load = array_if_wanted(weight, state.load)
    arrays = grain_arrays_of_bed(bed, state.fx, state.fy, stiffness, energy_and_closest, load)
    if dipole is None:
        clear_sums(arrays)
    else:
        _sum_magnetic_forces(constants.acting.cut, constants.acting.listing, bed, arrays)
    crowded = add_near_forces(near, state.near, grains, state.x, state.y, state.fx, state.fy)
    add_near_loads(near, state.near, grains, state.x, state.y, weight, load)
    return crowded


_add_forces = sum_of_hooks("add_forces", "bed time")
_measure = sum_of_hooks("measure_energy_and_stiffness", "bed time stiffness energies", backward=True)


@compiled(inline=True)
def compute_forces(bed: Bed, time: float) -> int:
    """Overwrite the forces on the grains and the walls, in natural units; time [tau]."""
    state, constants = bed.state, bed.constants
    acting = constants.acting
    crowded = _compute_pair_forces(acting.dipole, bed, None, None)
    crowded += refresh_far_field(state.far_forces, bed, time)
    add_far_field(state.far_forces, state, constants.grains, time)
    return crowded + _add_forces(acting.laws, state.workspaces, bed, time)


@compiled
def compute_and_measure_forces(bed: Bed, time: float, measurement: Measurement) -> int:
    """Overwrite all forces, as `compute_forces`, and sum what `potential_energies` needs; time [tau]."""
    state, constants = bed.state, bed.constants
    acting = constants.acting
    crowded = _compute_pair_forces(acting.dipole, bed, measurement.stiffness, measurement.energy_and_closest)
    crowded += compute_far_field(state.far_forces, bed, time)
    add_far_field(state.far_forces, state, constants.grains, time)
    return crowded + _add_forces(acting.laws, state.workspaces, bed, time)


@compiled
def kinetic_energy(bed: Bed) -> tuple[float, float]:
    """Kinetic energy of the grains, and the square of the greatest speed [F* D; D^2/tau^2]."""
    state, constants = bed.state, bed.constants
    fastest = 0.0
    for i in range(constants.grains):
        square = state.vx[i] * state.vx[i] + state.vy[i] * state.vy[i]
        fastest = max(fastest, square)
        state.scratch[i] = square
    return 0.5 * _sum_times_mass(state, constants.masses), fastest


@compiled
def _sum_times_mass(state: State, masses: Array | None) -> float:
    """Sum of the masses times what is in the scratch."""
    if masses is not None:
        for i in range(masses.size):
            state.scratch[i] *= masses[i]
    return reproducible_sum(state.scratch)


@compiled
def potential_energies(
    bed: Bed, time: float, measurement: Measurement, energies: Float[Array, "laws"]
) -> float:
    """Energy of the pairs [F* D]; also fill each law's energy and the bounds of stiffness [1/tau^2]."""
    state, constants = bed.state, bed.constants
    stiffness = measurement.stiffness
    # Gershgorin: the pair's stiffness 3 q_i q_j/r^5 enters the row of i twice, on the diagonal and beside it.
    bound = 6.0 * pair_stiffness_bound(constants.acting.series)
    for i in range(constants.grains):
        stiffness[i] *= bound
    multiply_by_moment_over_mass(stiffness, constants.acting.charges, constants.masses, constants.grains)
    near = measure_near_part(
        constants.acting.near, state.near, constants.grains, state.x, state.y, constants.masses, stiffness
    )
    energies[:] = 0.0
    _measure(constants.acting.laws, state.workspaces, bed, time, stiffness, energies)
    return ENERGY * measurement.energy_and_closest[0] + far_energy(state.far_forces) + near


@entry
def evaluate_forces(
    state: State, constants: Constants, measurement: Measurement, energies: Float[Array, "laws"]
) -> tuple[int, float, float]:
    """Overwrite all forces, at time 0; grains outside, energy of the pairs and kinetic energy [F* D]."""
    bed = by_reference(Bed(state, constants))
    measurement = by_reference(measurement)
    outside = compute_and_measure_forces(bed, 0.0, measurement)
    pairs = potential_energies(bed, 0.0, measurement, energies)
    return outside, pairs, kinetic_energy(bed)[0]
