"""Forces on the grains, and the corresponding energies and stiffness.

The far field of a mesh is part of every force evaluation, or acts in impulses at intervals of several steps.
With dry friction it is part of every evaluation, because sticking depends on the whole force. The field then
stays exactly constant while grains rest, and is extrapolated linearly over some steps while grains slide.
"""

from __future__ import annotations

from granular.compiled import Array, compiled, entry
from granular.compiled.hook_calls import by_reference, make_hook_sum_kernel
from granular.kernel_data.state import (
    Bed,
    Constants,
    MeasurementScratchArrays,
    State,
    add_to_velocity,
    grain_arrays_of_bed,
    multiply_by_moment_over_mass,
    pair_stiffness_bound_over_dipoles,
)
from granular.pairs.cut_off_sum import cut_off_sum
from granular.pairs.dipole_law import ENERGY
from granular.pairs.direct_sum import direct_sum, reproducible_sum
from granular.pairs.far_field import (
    CALLS,
    CHANGING,
    TIME,
    DirectFarFieldWorkspace,
    FarFieldState,
    compute_direct_far_field,
    compute_mesh_far_field,
)
from granular.pairs.grain_arrays import GrainArrays, array_if_requested, clear_sums, value_or_one
from granular.pairs.multilevel_mesh import MultilevelMesh
from granular.pairs.near_law import add_near_forces, add_near_loads, near_energy_and_add_stiffness
from granular.pairs.near_list import (
    VerletSettings,
    has_any_grain_moved,
    store_positions,
    sum_pairs_of_verlet_list,
)
from granular.pairs.stripes import CutOffSettings
from granular.shared.array_types import Float


@compiled(inline=True)
def compute_far_field(far: FarFieldState | None, bed: Bed, time: float) -> int:
    """Compute the far field at the present positions; return a non-zero number if its mesh overflows."""
    if far is None:
        return 0
    far.timing[TIME] = time
    far.timing[CALLS] = 0.0
    far.timing[CHANGING] = 0.0
    return _compute_far_forces_of_bed(far.mesh, far.direct, far, bed)


@compiled(inline=True)
def _compute_far_forces_of_bed(
    mesh: MultilevelMesh | None, direct: DirectFarFieldWorkspace | None, far: FarFieldState, bed: Bed
) -> int:
    state, constants = bed.state, bed.constants
    assert state.stripes is not None
    crowded, grains, threaded = 0, constants.grains, constants.threaded
    arrays = grain_arrays_of_bed(bed, far.fx, far.fy, None, None, far.load)
    if mesh is not None:
        crowded = compute_mesh_far_field(mesh, far, threaded, grains, arrays, state.stripes.order)
    if direct is not None:
        compute_direct_far_field(direct, state.stripes, far.radius, threaded, grains, arrays, far.energy)
        store_positions(far.evaluated_at, state.x, state.y, grains)
    return crowded


@compiled(inline=True)
def refresh_far_field(far: FarFieldState | None, bed: Bed, time: float) -> int:
    """Update the far field if it is part of every force evaluation, but not if it acts in impulses."""
    if far is None:
        return 0
    return _compute_far_field_and_rates_if_moved(far.held_forces, far.evaluated_at, far.rates, far, bed, time)


@compiled(inline=True)
def _compute_far_field_and_rates_if_moved(
    held: Array | None, met: Array | None, rates: Array | None, far: FarFieldState, bed: Bed, time: float
) -> int:
    """If a grain has moved, compute the far field, and its rate of change since a recent evaluation."""
    if held is not None:
        return 0
    if met is None:
        return compute_far_field(far, bed, time)
    state, constants = bed.state, bed.constants
    far.timing[CALLS] += 1.0
    if far.timing[CHANGING] > 0.0 and far.timing[CALLS] < far.extrapolation_steps:
        return 0
    # While no grain has moved further, the force on grains at rest stays exactly the same.
    if not has_any_grain_moved(met, state.x, state.y, constants.grains, far.unchanged_distance**2):
        far.timing[CHANGING] = 0.0
        return 0
    if rates is None:
        return compute_far_field(far, bed, time)
    lapse = time - far.timing[TIME]
    is_recent = far.timing[CALLS] <= far.extrapolation_steps and lapse > 0.0
    _store_far_forces(rates, far)
    crowded = compute_far_field(far, bed, time)
    if is_recent:
        _store_far_force_rates(rates, far, lapse)
        far.timing[CHANGING] = 1.0
    return crowded


@compiled
def _store_far_forces(rates: Array, far: FarFieldState) -> None:
    for i in range(far.fx.size):
        rates[0, i] = far.fx[i]
        rates[1, i] = far.fy[i]
        rates[2, i] = value_or_one(far.load, i)


@compiled
def _store_far_force_rates(rates: Array, far: FarFieldState, lapse: float) -> None:
    for i in range(far.fx.size):
        rates[0, i] = (far.fx[i] - rates[0, i]) / lapse
        rates[1, i] = (far.fy[i] - rates[1, i]) / lapse
        rates[2, i] = (value_or_one(far.load, i) - rates[2, i]) / lapse


@compiled(inline=True)
def add_far_field(far: FarFieldState | None, state: State, count: int, time: float) -> None:
    """Add the far field (the stored field, if it acts in impulses) to forces and normal loads."""
    if far is not None:
        _add_held_forces(far.held_forces, far, state.load, state, count)
        if far.timing[CHANGING] > 0.0:
            _add_extrapolated_forces(far.rates, state.load, time - far.timing[TIME], state, count)


@compiled
def _add_held_forces(
    held: Array | None, far: FarFieldState, load: Array | None, state: State, count: int
) -> None:
    if held is None:
        for i in range(count):
            state.fx[i] += far.fx[i]
            state.fy[i] += far.fy[i]
        if load is not None and far.load is not None:
            for i in range(count):
                load[i] += far.load[i]
    else:
        for i in range(count):
            state.fx[i] += held[0, i]
            state.fy[i] += held[1, i]


@compiled
def _add_extrapolated_forces(
    rates: Array | None, load: Array | None, lapse: float, state: State, count: int
) -> None:
    if rates is not None:
        for i in range(count):
            state.fx[i] += lapse * rates[0, i]
            state.fy[i] += lapse * rates[1, i]
        if load is not None:
            for i in range(count):
                load[i] += lapse * rates[2, i]


@compiled
def far_field_energy(far: FarFieldState | None) -> float:
    """Energy of the far field at its last evaluation."""
    return 0.0 if far is None else far.energy[0]


@compiled
def kick_by_far_field_change(far: FarFieldState | None, dt: float, bed: Bed) -> None:
    """Change velocities by the present far field minus the stored field, acting for a time ``dt``."""
    state, constants = bed.state, bed.constants
    if far is not None:
        _kick_by_change_since_held(
            state.rounding, far.held_forces, far, dt, state, constants.masses, constants.grains
        )


@compiled
def _kick_by_change_since_held(
    rounding: Array | None,
    held: Array | None,
    far: FarFieldState,
    dt: float,
    state: State,
    masses: Array | None,
    count: int,
) -> None:
    if held is not None:
        for i in range(count):
            gain = dt
            if masses is not None:
                gain /= masses[i]
            by_x, by_y = far.fx[i] - held[0, i], far.fy[i] - held[1, i]
            add_to_velocity(rounding, state, i, gain * by_x, gain * by_y)


def hold_present_far_field(state: State) -> None:
    """If the far field acts in impulses, store the present field, which then acts in every step."""
    far = state.far_forces
    if far is not None and far.held_forces is not None:
        # The energy is unchanged, but the conserved quantity of the symplectic step changes slightly:
        # do it rarely in conservative scenes.
        state.fx[:] += far.fx - far.held_forces[0]
        state.fy[:] += far.fy - far.held_forces[1]
        far.held_forces[0], far.held_forces[1] = far.fx, far.fy


def force_components_with_far_field(state: State) -> tuple[Array, Array]:
    """Return the force components fx, fy (m,) on the grains, including a far field that acts in impulses."""
    far = state.far_forces
    if far is None or far.held_forces is None:
        return state.fx, state.fy
    return state.fx + far.fx - far.held_forces[0], state.fy + far.fy - far.held_forces[1]


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
        sum_pairs_of_verlet_list(state.verlet_list, grains, arrays)


@compiled(inline=True)
def _compute_pair_forces(
    dipole: bool | None, bed: Bed, stiffness: Array | None, energy_and_closest: Array | None
) -> int:
    """Compute the pair forces; return the number of pairs that are impossibly close."""
    state, constants = bed.state, bed.constants
    weight, near, grains = constants.acting.weight, constants.acting.near, constants.grains
    load = array_if_requested(weight, state.load)
    arrays = grain_arrays_of_bed(bed, state.fx, state.fy, stiffness, energy_and_closest, load)
    if dipole is None:
        clear_sums(arrays)
    else:
        _sum_magnetic_forces(constants.acting.cut, constants.acting.listing, bed, arrays)
    crowded = add_near_forces(near, state.near, grains, state.x, state.y, state.fx, state.fy)
    add_near_loads(near, state.near, grains, state.x, state.y, weight, load)
    return crowded


_add_forces = make_hook_sum_kernel("add_forces", "bed time")
_measure = make_hook_sum_kernel("measure_energy_and_stiffness", "bed time stiffness energies", backward=True)


@compiled(inline=True)
def compute_forces(bed: Bed, time: float) -> int:
    """Overwrite the forces on the grains and the walls; return the number of impossible positions."""
    state, constants = bed.state, bed.constants
    acting = constants.acting
    crowded = _compute_pair_forces(acting.dipole, bed, None, None)
    crowded += refresh_far_field(state.far_forces, bed, time)
    add_far_field(state.far_forces, state, constants.grains, time)
    return crowded + _add_forces(acting.laws, state.workspaces, bed, time)


@compiled
def compute_and_measure_forces(bed: Bed, time: float, measurement: MeasurementScratchArrays) -> int:
    """Overwrite all forces like `compute_forces`, and compute the sums for the measured energies."""
    state, constants = bed.state, bed.constants
    acting = constants.acting
    crowded = _compute_pair_forces(acting.dipole, bed, measurement.stiffness, measurement.energy_and_closest)
    crowded += compute_far_field(state.far_forces, bed, time)
    add_far_field(state.far_forces, state, constants.grains, time)
    return crowded + _add_forces(acting.laws, state.workspaces, bed, time)


@compiled
def kinetic_energy_and_maximum_squared_speed(bed: Bed) -> tuple[float, float]:
    """Return the kinetic energy of the grains, and the square of their maximum speed."""
    state, constants = bed.state, bed.constants
    fastest = 0.0
    for i in range(constants.grains):
        square = state.vx[i] * state.vx[i] + state.vy[i] * state.vy[i]
        fastest = max(fastest, square)
        state.scratch[i] = square
    return 0.5 * _sum_of_scratch_times_mass(state, constants.masses), fastest


@compiled
def _sum_of_scratch_times_mass(state: State, masses: Array | None) -> float:
    """Return the sum of mass times scratch entry over the grains; products overwrite the scratch array."""
    if masses is not None:
        for i in range(masses.size):
            state.scratch[i] *= masses[i]
    return reproducible_sum(state.scratch)


@compiled
def pair_energy_and_fill_law_energies(
    bed: Bed, time: float, measurement: MeasurementScratchArrays, energies: Float[Array, "laws"]
) -> float:
    """Return the energy of the pairs; fill in the laws' energies, and bounds of stiffness divided by mass."""
    state, constants = bed.state, bed.constants
    stiffness = measurement.stiffness
    # Gershgorin: the pair's stiffness 3 q_i q_j/r^5 enters row i twice, on the diagonal and off it.
    bound = 6.0 * pair_stiffness_bound_over_dipoles(constants.acting.series)
    for i in range(constants.grains):
        stiffness[i] *= bound
    multiply_by_moment_over_mass(stiffness, constants.acting.charges, constants.masses, constants.grains)
    near = near_energy_and_add_stiffness(
        constants.acting.near, state.near, constants.grains, state.x, state.y, constants.masses, stiffness
    )
    energies[:] = 0.0
    _measure(constants.acting.laws, state.workspaces, bed, time, stiffness, energies)
    return ENERGY * measurement.energy_and_closest[0] + far_field_energy(state.far_forces) + near


@entry
def compute_forces_and_energies(
    state: State, constants: Constants, measurement: MeasurementScratchArrays, energies: Float[Array, "laws"]
) -> tuple[int, float, float]:
    """Compute all forces at time 0; return the number of misplaced grains, pair energy and kinetic energy."""
    bed = by_reference(Bed(state, constants))
    measurement = by_reference(measurement)
    outside = compute_and_measure_forces(bed, 0.0, measurement)
    pairs = pair_energy_and_fill_law_energies(bed, 0.0, measurement, energies)
    return outside, pairs, kinetic_energy_and_maximum_squared_speed(bed)[0]
