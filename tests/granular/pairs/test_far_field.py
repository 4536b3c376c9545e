"""Long-range part of the pair force: its definition, its sums by mesh and over all pairs, and its use
with friction.
"""

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from granular import Scene, plan, simulate
from granular.compiled import entry
from granular.engine.forces import add_far_field, refresh_far_field
from granular.kernel_data.state import Bed as KernelBed
from granular.methods import method_named
from granular.pairs import far_field
from granular.pairs.dipole_law import far_part_of_inverse_cube, far_part_of_inverse_fifth
from granular.pairs.direct_sum import pad_coordinates, pad_values
from granular.pairs.far_field import (
    EXTRAPOLATION_STEPS,
    TIME,
    UNCHANGED_DISTANCE,
    FarFieldSettings,
    FarFieldState,
    allocate_direct_far_field,
    allocate_far_field_state,
)
from granular.pairs.grain_arrays import GrainArrays
from granular.pairs.pair_sum_settings import SPLIT_RADIUS as RADIUS
from granular.pairs.pair_sum_settings import TOLERANCE
from granular.pairs.stripes import allocate_stripes
from granular.run.protocol_runner import ProtocolRunner
from granular.run.run_state import ARRANGE
from granular.scene.named_scenes import mono_bed
from granular.scene.scene_in_natural_units import scene_in_natural_units
from granular.shared.errors import InputError, SceneError

compute_mesh_far_field = entry(far_field.compute_mesh_far_field)
compute_direct_far_field = entry(far_field.compute_direct_far_field)


@given(ratio=st.floats(0.05, 4.0), radius=st.floats(0.5, 50.0))
def test_long_range_force_is_the_negative_derivative_of_the_long_range_energy(
    ratio: float, radius: float
) -> None:
    """The relation d(r^-3)/dr = -3 r r^-5 also holds between the long-range parts of r^-3 and r^-5."""
    r, h = ratio * radius, 1e-4 * radius
    slope = (
        far_part_of_inverse_cube((r + h) ** 2, radius) - far_part_of_inverse_cube((r - h) ** 2, radius)
    ) / (2.0 * h)
    np.testing.assert_allclose(slope, -3.0 * r * far_part_of_inverse_fifth(r**2, radius), rtol=1e-5)


def test_long_range_part_equals_the_pair_law_beyond_the_cut_off_and_is_smooth_there() -> None:
    r = np.array([RADIUS, 8.0, 100.0])
    np.testing.assert_allclose(far_part_of_inverse_cube(r**2, RADIUS), r**-3.0, rtol=1e-14)
    np.testing.assert_allclose(far_part_of_inverse_fifth(r**2, RADIUS), r**-5.0, rtol=1e-14)
    # Three derivatives agree: the fourth differences across the radius fall with the fourth power.
    jumps = []
    for h in (0.2, 0.1):
        near = np.diff(far_part_of_inverse_cube((RADIUS + h * np.arange(-4, 1)) ** 2, RADIUS), 4)[0]
        far = np.diff(far_part_of_inverse_cube((RADIUS + h * np.arange(0, 5)) ** 2, RADIUS), 4)[0]
        jumps.append(abs(near - far))
    assert jumps[0] / jumps[1] == pytest.approx(16.0, rel=0.2)


def far_arrays(far: FarFieldState, x: object, y: object, *own: object) -> GrainArrays:
    """Return arrays of a bed for long-range forces and friction loads."""
    moments, weight = own or (None, None)
    return GrainArrays(x, y, far.fx, far.fy, moments, None, None, far.load, weight)


class Bed:
    """A disturbed hexagonal bed at packing fraction 0.241, as after full compression."""

    threaded: bool | None = None

    def __init__(self, count: int, *, differing: bool = False, seed: int = 1) -> None:
        self.width, self.height = 60.0 * (count / 368) ** 0.5, 20.0 * (count / 368) ** 0.5
        apart = (2.0 / 3.0**0.5 * self.width * self.height / count) ** 0.5
        across, up = int(self.width / apart), int(self.height / (apart * 0.75**0.5))
        places = [
            ((i + 0.5 * (j % 2) + 0.25) * self.width / across, (j + 0.5) * self.height / up)
            for j, i in itertools.product(range(up), range(across))
        ]
        random = np.random.default_rng(seed)
        self.places = np.array(places) + 0.1 * apart * random.standard_normal((len(places), 2))
        self.count = len(places)
        self.x, self.y = pad_coordinates(self.places)
        moments = random.choice([0.36, 1.0], self.count)
        self.padded_moments = pad_values(moments) if differing else None
        self.weight = pad_values(0.3 + 0.5 * moments if differing else np.full(self.count, 0.7))

    def workspace(self) -> FarFieldState:
        field = FarFieldSettings(RADIUS, (self.width + 6.0, self.height + 6.0), None)
        return allocate_far_field_state(field, self.x.size, with_loads=True)

    def far(self) -> FarFieldState:
        far = self.workspace()
        moments, weight = self.padded_moments, self.weight
        assert self.found(far, moments, weight) == 0
        return far

    def found(self, far: FarFieldState, moments: object = None, weight: object = None) -> int:
        order = np.random.default_rng(2).permutation(self.count)
        arrays = far_arrays(far, self.x, self.y, moments, weight)
        return compute_mesh_far_field(far.mesh, far, self.threaded, self.count, arrays, order)

    @property
    def moments(self) -> np.ndarray:
        if self.padded_moments is None:
            return np.ones(self.count)
        return self.padded_moments[: self.count]

    def exact(self) -> tuple[np.ndarray, float, np.ndarray, float]:
        """Return long-range forces, energy and friction loads over all pairs, and the rms sum of force
        magnitudes.
        """
        apart = self.places[:, None] - self.places[None]
        square, products = (apart**2).sum(axis=2), self.moments[:, None] * self.moments[None]
        forces = 0.75 * ((products * far_part_of_inverse_fifth(square, RADIUS))[..., None] * apart).sum(
            axis=1
        )
        cubes = far_part_of_inverse_cube(square, RADIUS)
        np.fill_diagonal(cubes, 0.0)
        np.fill_diagonal(square, np.inf)
        unit = np.sqrt(np.mean((0.75 * products * square**-2.0).sum(axis=1) ** 2))
        return forces, 0.125 * float((products * cubes).sum()), cubes @ self.weight[: self.count], float(unit)


@pytest.mark.parametrize("differing", [False, True])
@pytest.mark.parametrize("count", [30, 92, 1472])
def test_long_range_sum_by_a_mesh_agrees_with_the_sum_over_all_pairs(count: int, differing: bool) -> None:
    """Forces agree to the tolerance stated for the packaged cut-off."""
    bed = Bed(count, differing=differing)
    far, n = bed.far(), bed.count
    forces, energy, load, unit = bed.exact()
    error = np.hypot(far.fx[:n] - forces[:, 0], far.fy[:n] - forces[:, 1])
    assert error.max() < TOLERANCE * unit
    assert far.energy[0] == pytest.approx(energy, rel=1e-3)
    assert far.load is not None
    np.testing.assert_allclose(far.load[:n], load, atol=1e-3 * load.max())


def test_direct_long_range_sum_agrees_with_the_sum_over_all_pairs() -> None:
    bed = Bed(150, differing=True)
    fx, fy, load, energy = (np.zeros_like(bed.x) for _ in range(4))
    compute_direct_far_field(
        allocate_direct_far_field(bed.x.size, with_loads=True),
        allocate_stripes(bed.x.size, moments=True, with_loads=True),
        RADIUS,
        None,
        bed.count,
        GrainArrays(bed.x, bed.y, fx, fy, bed.padded_moments, load=load, weight=bed.weight),
        energy,
    )
    found = np.column_stack([fx, fy])[: bed.count]
    forces, wanted_energy, loads, _ = bed.exact()
    # Taken as a difference: what is left is rounded as the whole forces of close pairs are.
    np.testing.assert_allclose(found, forces, atol=1e-13)
    np.testing.assert_allclose(found.sum(axis=0), 0.0, atol=1e-13)  # action and reaction
    assert energy[0] == pytest.approx(wanted_energy, rel=1e-11)
    np.testing.assert_allclose(load[: bed.count], loads, rtol=1e-11)


@pytest.mark.parametrize("differing", [False, True])
def test_mesh_force_is_the_negative_gradient_of_the_mesh_energy_up_to_rounding(differing: bool) -> None:
    """Energy is therefore conserved whatever the error of the mesh."""
    bed = Bed(92, differing=differing)
    far, step = bed.far(), 1e-4
    for grain in (0, 17, bed.count - 1):
        for places, force in ((bed.x, far.fx), (bed.y, far.fy)):
            energies = []
            for by in (-2.0, -1.0, 1.0, 2.0):
                places[grain] += by * step
                energies.append(bed.far().energy[0])
                places[grain] -= by * step
            slope = (energies[0] - 8 * energies[1] + 8 * energies[2] - energies[3]) / (12 * step)
            assert slope == pytest.approx(-force[grain], abs=1e-9)


def test_mesh_forces_do_not_change_if_the_bed_is_shifted_by_the_coarsest_mesh_spacing() -> None:
    bed = Bed(368)
    far = bed.far()
    shift = far.mesh.spacing * 2.0 ** (len(far.mesh.windows) - 1)
    bed.x[: bed.count] += shift
    bed.y[: bed.count] -= 2.0 * shift
    moved = bed.far()
    np.testing.assert_allclose(moved.fx, far.fx, atol=1e-13)
    np.testing.assert_allclose(moved.fy, far.fy, atol=1e-13)


def test_grains_outside_the_mesh_and_nan_positions_are_detected() -> None:
    bed = Bed(92)
    workspace = bed.workspace()
    bed.y[3] += 1e3
    assert bed.found(workspace, None, bed.weight) == 1
    assert np.isnan(workspace.energy[0])
    bed.y[3] = np.nan
    assert bed.found(bed.workspace(), None, bed.weight) == 0
    arrays = far_arrays(workspace, bed.x, bed.y, None, bed.weight)
    assert compute_mesh_far_field(workspace.mesh, workspace, None, 0, arrays, np.arange(1)) == 0


def test_long_range_force_on_a_single_grain_is_zero_up_to_the_mesh_error() -> None:
    x, y = pad_coordinates(np.array([[3.3, 4.4]]))
    far = allocate_far_field_state(FarFieldSettings(RADIUS, (20.0, 20.0), None), x.size, with_loads=True)
    arrays = far_arrays(far, x, y, None, pad_values(np.ones(1)))
    assert compute_mesh_far_field(far.mesh, far, None, 1, arrays, np.arange(1)) == 0
    neighbour = 0.75 / 1.8**4
    assert np.hypot(far.fx[0], far.fy[0]) < 1e-3 * neighbour


def test_mesh_memory_is_linear_in_the_cell_area() -> None:
    sizes = []
    for count in (10_000, 1_000_000):
        side = (count / 0.3) ** 0.5
        workspace = allocate_far_field_state(
            FarFieldSettings(RADIUS, (side, side), None), count, with_loads=True
        )
        assert workspace.mesh is not None
        arrays = [*workspace.mesh, *workspace]
        sizes.append(sum(one.nbytes for one in arrays if isinstance(one, np.ndarray)) / count)
    assert sizes[1] < sizes[0] < 220.0


def on_mesh(scene: Scene, **changes: object) -> Scene:
    return scene.replace(**{"pairs": {"method": "mesh", "cut_off": "3 D", **changes}})


def rubbing(scene: Scene) -> Scene:
    return scene.replace(**{"effects.friction": {}})


def test_scene_keys_select_the_mesh_sum(bed: Scene, small_bed: Scene) -> None:
    assert bed.pair_method == "direct"
    large = mono_bed(1500)
    assert large.pair_method == "mesh"
    assert large.replace(**{"effects.walls.left": None}).pair_method == "direct"
    assert large.replace(**{"pairs.method": "direct"}).pair_method == "direct"
    radii = [
        large.replace(**{"pairs.tolerance": one}).pairs.near_pair_radius("mesh", 0.006)
        for one in (TOLERANCE, 0.1 * TOLERANCE)
    ]
    assert radii == pytest.approx([RADIUS, RADIUS * 10.0 ** (1 / 3.36)])
    with pytest.raises(SceneError, match=r"pairs\.method: 'mesh' needs a closed cell"):
        small_bed.replace(**{"effects.walls.left": None, "pairs.method": "mesh"})
    with pytest.raises(SceneError, match=r"pairs\.far_every: applies only to the methods 'auto', 'mesh'"):
        small_bed.replace(**{"pairs": {"method": "cut-off", "far_every": 2}})
    with pytest.raises(SceneError, match=r"pairs\.tolerance: 0\.1 must be at most"):
        small_bed.replace(**{"pairs.tolerance": 0.1})


def test_a_cell_whose_mesh_would_be_too_large_is_refused(bed: Scene) -> None:
    high = bed.replace(**{"pairs.method": "mesh", "piston.height": "1e12 D"})
    with pytest.raises(InputError, match=r"needs 4\.31e\+13 points .* use 'direct'"):
        simulate(high, t_end=0.01, progress=False)


def test_long_range_impulses_every_few_steps_are_refused_for_unsuitable_methods(small_damper: Scene) -> None:
    with pytest.raises(InputError, match=r"pairs\.far_every = 4: 'pefrl' does not support it"):
        simulate(on_mesh(small_damper, far_every=4), t_end=0.01, method="pefrl", progress=False)


@pytest.mark.long
@pytest.mark.parametrize("pairs", [{"method": "mesh", "cut_off": "3 D"}, {"method": "direct"}], ids=str)
def test_long_range_impulses_every_four_steps_converge_with_order_two(
    pairs: dict[str, str], small_damper: Scene
) -> None:
    scene = small_damper.replace(**{"effects.drag": None}, pairs={**pairs, "far_every": 4})
    ends = [
        simulate(scene, dt=dt, t_end=0.016, progress=False).dataset["position"].values[-1]
        for dt in (4e-5, 2e-5, 1e-5, 1.25e-6)
    ]
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(slopes, 2.0, atol=0.1)


@pytest.mark.long
@pytest.mark.parametrize("method", ["stormer-verlet", "blanes-moan-4"])
def test_a_run_with_the_mesh_sum_agrees_with_the_direct_sum_under_friction_or_by_another_method(
    small_bed: Scene, small_damper: Scene, method: str
) -> None:
    """In both cases the long-range part is computed at every evaluation of the forces.

    With friction, it also contributes to the friction load.
    """
    scene = rubbing(small_bed) if method == "stormer-verlet" else small_damper
    meshed = simulate(on_mesh(scene), t_end=0.1, method=method, progress=False)
    exact = simulate(scene, t_end=0.1, method=method, progress=False)
    assert meshed.settings()["ledger_residual"] < 1e-3
    forces = [run.dataset["piston_force"].values[:50] for run in (meshed, exact)]
    np.testing.assert_allclose(*forces, rtol=5e-3)


evaluate_far = entry(refresh_far_field)
add_far = entry(add_far_field)


def spared(scene: Scene, **changes: object) -> Scene:
    """Return the scene with the direct sum and long-range forces evaluated less often."""
    return scene.replace(**{"pairs": {"method": "direct", "far_every": 8, **changes}})


Far = Callable[..., Scene]
both = pytest.mark.parametrize("far", [on_mesh, spared])


def moving(scene: Scene) -> Scene:
    """Return a scene with sliding grains and no other dissipation."""
    return scene.replace(**{"effects.drag": None, "effects.gravity": None, "arrangement.speed": "2 D/s"})


@pytest.mark.long
def test_long_range_forces_are_reused_while_grains_with_friction_hardly_move(small_bed: Scene) -> None:
    """They are evaluated again once any grain has moved further."""
    method = method_named("stormer-verlet")
    scene = on_mesh(rubbing(small_bed))
    system = scene_in_natural_units(scene, method=method)
    run = ProtocolRunner(plan(scene, threads=1))
    run.begin_stage()
    state, far = run.state, run.state.far_forces
    assert far is not None
    before = far.fx.copy()
    for by, finds in (
        (0.4 * UNCHANGED_DISTANCE, False),
        (-0.8 * UNCHANGED_DISTANCE, False),
        (1.6 * UNCHANGED_DISTANCE, True),
    ):
        for places in (state.x, state.y):
            far.fx[:] = before
            start = places.copy()
            places[5] += by
            evaluate_far(far, KernelBed(state, run.grain_constants), 0.0)
            assert (far.fx != before).any() == finds
            places[:] = start
            run.present_record(ARRANGE)
    assert system.constants.acting.far is not None
    often = scene_in_natural_units(on_mesh(rubbing(small_bed), far_every=1), method=method)
    assert often.constants.acting.far == system.constants.acting.far._replace(rubbing=None)
    seldom = scene_in_natural_units(on_mesh(rubbing(small_bed), far_every=4), method=method)
    assert seldom.constants.acting.far == system.constants.acting.far._replace(rubbing=4)
    at_all = scene_in_natural_units(spared(rubbing(small_bed), far_every=1), method=method)
    assert at_all.constants.acting.far is None


@pytest.mark.long
def test_long_range_forces_are_extrapolated_while_grains_slide(small_bed: Scene) -> None:
    """Forces and friction loads are extrapolated for up to `EXTRAPOLATION_STEPS` steps, and then
    evaluated again.
    """
    dt, speed = 0.02, 0.3

    def force_of(rubs: int | None, steps: int) -> tuple[np.ndarray, float]:
        """Return long-range force and load after steps at constant speed, and the time of the last
        evaluation.
        """
        run = ProtocolRunner(plan(on_mesh(rubbing(small_bed), far_every=rubs or 1), threads=1))
        run.begin_stage()
        state, constants = run.state, run.grain_constants
        assert state.far_forces is not None
        assert state.load is not None
        way = speed * np.random.default_rng(4).standard_normal((2, constants.grains))
        for step in range(steps + 1):
            assert evaluate_far(state.far_forces, KernelBed(state, constants), dt * step) == 0
            if step < steps:
                state.x[: constants.grains] += dt * way[0]
                state.y[: constants.grains] += dt * way[1]
        for sums in (state.fx, state.fy, state.load):
            sums[:] = 0.0
        add_far(state.far_forces, state, constants.grains, dt * steps)
        found = np.array([state.fx, state.fy, state.load])
        return found, float(state.far_forces.timing[TIME])

    for steps, met in ((EXTRAPOLATION_STEPS, 1), (EXTRAPOLATION_STEPS + 1, EXTRAPOLATION_STEPS + 1)):
        exact, _ = force_of(None, steps)
        still, when = force_of(EXTRAPOLATION_STEPS, met)
        assert when == pytest.approx(met * dt)
        going, when = force_of(EXTRAPOLATION_STEPS, steps)
        assert when == pytest.approx(met * dt)
        if steps > met:
            left = np.abs(going - exact).max(axis=1)
            assert (left < 0.3 * np.abs(still - exact).max(axis=1)).all()
        else:
            np.testing.assert_allclose(going, exact, atol=1e-15)


@both
@pytest.mark.long  # quick: how the far field goes on
def test_extrapolated_long_range_forces_converge_with_order_two_while_grains_slide(
    far: Far, small_bed: Scene
) -> None:
    scene = moving(far(rubbing(small_bed)))
    ends = [
        simulate(scene, dt=dt, t_end=0.016, progress=False).dataset["position"].values[-1]
        for dt in (4e-5, 2e-5, 1e-5, 5e-6, 1.25e-6)
    ]
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    assert np.log2(errors[0] / errors[-1]) / 3.0 == pytest.approx(2.0, abs=0.25)
    assert (np.diff(errors) < 0.0).all()


@both
@pytest.mark.long  # quick: when the far field is found again
def test_reused_long_range_forces_give_the_same_piston_force_on_a_settled_bed_with_friction(
    far: Far, small_bed: Scene
) -> None:
    """The reference run computes the long-range forces in every step. Sticking grains do not move."""
    runs = [
        simulate(far(rubbing(small_bed), **keys), t_end=0.6, progress=False).dataset
        for keys in ({}, {"far_every": 1})
    ]
    forces = [one["piston_force"].values[-1] for one in runs]
    assert forces[0] == pytest.approx(forces[1], rel=5e-4)
    moved = np.abs(runs[0]["position"].values[-1] - runs[0]["position"].values[-2])
    assert (moved == 0.0).mean() > 0.5


@both
@pytest.mark.long
def test_resumed_run_with_extrapolated_forces_is_bit_identical_to_an_uninterrupted_one(
    far: Far, small_bed: Scene, tmp_path: Path
) -> None:
    """The extrapolation depends only on the stored state, for any time of the interruption."""
    scene = moving(far(rubbing(small_bed)))
    integer = simulate(scene, t_end=0.05, progress=False).dataset
    for end in (0.0123, 0.0307, 0.05):
        parts = simulate(scene, t_end=end, out=str(tmp_path), resume=end > 0.02, progress=False).dataset
    for name in ("position", "velocity", "force"):
        np.testing.assert_array_equal(integer[name].values[-1], parts[name].values[-1])
