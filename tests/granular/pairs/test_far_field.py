"""The smooth split of the pair law, and its far part on a mesh."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from granular import Scene, simulate
from granular.compiled import entry
from granular.pairs import far_field
from granular.pairs.dipole_law import far_part_of_inverse_cube, far_part_of_inverse_fifth
from granular.pairs.direct_sum import pad_coordinates, pad_values
from granular.pairs.far_field import FarFieldSettings, FarFieldState, far_field_state
from granular.pairs.grain_arrays import GrainArrays
from granular.pairs.pair_sum_settings import SPLIT_RADIUS as RADIUS
from granular.pairs.pair_sum_settings import TOLERANCE
from granular.scene.named_scenes import mono_bed
from granular.shared.errors import InputError, SceneError

compute_mesh_far_field = entry(far_field.compute_mesh_far_field)


@given(ratio=st.floats(0.05, 4.0), radius=st.floats(0.5, 50.0))
def test_force_is_the_slope_of_the_energy(ratio: float, radius: float) -> None:
    """d(r^-3)/dr = -3 r r^-5, for the far parts as for the law."""
    r, h = ratio * radius, 1e-4 * radius
    slope = (
        far_part_of_inverse_cube((r + h) ** 2, radius) - far_part_of_inverse_cube((r - h) ** 2, radius)
    ) / (2.0 * h)
    np.testing.assert_allclose(slope, -3.0 * r * far_part_of_inverse_fifth(r**2, radius), rtol=1e-5)


def test_far_part_is_the_law_outside_and_smooth_at_the_radius() -> None:
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
    """Arrays of a bed whose forces and loads go to the far field."""
    moments, weight = own or (None, None)
    return GrainArrays(x, y, far.fx, far.fy, moments, None, None, far.load, weight)


class Bed:
    """A disturbed hexagonal bed at packing 0.241, as a full compression leaves it."""

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
        return far_field_state(field, self.x.size, with_loads=True)

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

    def differences(self) -> tuple[np.ndarray, np.ndarray]:
        apart = self.places[:, None] - self.places[None]
        return apart, (apart**2).sum(axis=2)


@pytest.mark.parametrize("differing", [False, True])
@pytest.mark.parametrize("count", [30, 92, 1472])
def test_mesh_is_the_sum_over_all_pairs(count: int, differing: bool) -> None:
    """Forces to the tolerance that the packaged radius stands for."""
    bed = Bed(count, differing=differing)
    far, q, n = bed.far(), bed.moments, bed.count
    apart, square = bed.differences()
    products = q[:, None] * q[None]
    forces = 0.75 * ((products * far_part_of_inverse_fifth(square, RADIUS))[..., None] * apart).sum(axis=1)
    np.fill_diagonal(square, np.inf)
    unit = np.sqrt(np.mean((0.75 * products * square**-2.0).sum(axis=1) ** 2))
    error = np.hypot(far.fx[:n] - forces[:, 0], far.fy[:n] - forces[:, 1])
    assert error.max() < TOLERANCE * unit
    cubes = far_part_of_inverse_cube(np.where(np.isinf(square), 0.0, square), RADIUS)
    np.fill_diagonal(cubes, 0.0)
    assert far.energy[0] == pytest.approx(0.125 * (products * cubes).sum(), rel=1e-3)
    load = cubes @ bed.weight[:n]
    assert far.load is not None
    np.testing.assert_allclose(far.load[:n], load, atol=1e-3 * load.max())


@pytest.mark.parametrize("differing", [False, True])
def test_force_is_the_exact_gradient_of_the_mesh_s_energy(differing: bool) -> None:
    """To the rounding of the difference: energy is conserved whatever the mesh's own error is."""
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


def test_lattice_stands_still() -> None:
    """A bed that moves by a whole spacing of the coarsest mesh feels the same."""
    bed = Bed(368)
    far = bed.far()
    shift = far.mesh.spacing * 2.0 ** (len(far.mesh.windows) - 1)
    bed.x[: bed.count] += shift
    bed.y[: bed.count] -= 2.0 * shift
    moved = bed.far()
    np.testing.assert_allclose(moved.fx, far.fx, atol=1e-13)
    np.testing.assert_allclose(moved.fy, far.fy, atol=1e-13)


def test_no_room_and_no_number() -> None:
    bed = Bed(92)
    workspace = bed.workspace()
    bed.y[3] += 1e3
    assert bed.found(workspace, None, bed.weight) == 1
    assert np.isnan(workspace.energy[0])
    bed.y[3] = np.nan
    assert bed.found(bed.workspace(), None, bed.weight) == 0
    arrays = far_arrays(workspace, bed.x, bed.y, None, bed.weight)
    assert compute_mesh_far_field(workspace.mesh, workspace, None, 0, arrays, np.arange(1)) == 0


def test_one_grain_feels_nothing_but_the_mesh_s_error() -> None:
    x, y = pad_coordinates(np.array([[3.3, 4.4]]))
    far = far_field_state(FarFieldSettings(RADIUS, (20.0, 20.0), None), x.size, with_loads=True)
    arrays = far_arrays(far, x, y, None, pad_values(np.ones(1)))
    assert compute_mesh_far_field(far.mesh, far, None, 1, arrays, np.arange(1)) == 0
    neighbour = 0.75 / 1.8**4
    assert np.hypot(far.fx[0], far.fy[0]) < 1e-3 * neighbour


def test_room_is_linear_in_the_cell() -> None:
    sizes = []
    for count in (10_000, 1_000_000):
        side = (count / 0.3) ** 0.5
        workspace = far_field_state(FarFieldSettings(RADIUS, (side, side), None), count, with_loads=True)
        assert workspace.mesh is not None
        arrays = [*workspace.mesh, *workspace]
        sizes.append(sum(one.nbytes for one in arrays if isinstance(one, np.ndarray)) / count)
    assert sizes[1] < sizes[0] < 220.0


def on_mesh(scene: Scene, **changes: object) -> Scene:
    return scene.replace(**{"pairs": {"method": "mesh", "cut_off": "3 D", **changes}})


def rubbing(scene: Scene) -> Scene:
    return scene.replace(**{"effects.friction": {}})


def test_scene_chooses_the_mesh(bed: Scene, small_bed: Scene) -> None:
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
    with pytest.raises(SceneError, match=r"pairs\.far_every: only the methods 'mesh'"):
        small_bed.replace(**{"pairs": {"method": "cut-off", "far_every": 2}})
    with pytest.raises(SceneError, match=r"pairs\.tolerance: 0\.1 must be at most"):
        small_bed.replace(**{"pairs.tolerance": 0.1})


def test_a_cell_for_too_large_a_mesh_is_refused(bed: Scene) -> None:
    high = bed.replace(**{"pairs.method": "mesh", "piston.height": "1e12 D"})
    with pytest.raises(InputError, match=r"needs 4\.31e\+13 points .* take 'direct'"):
        simulate(high, t_end=0.01, progress=False)


def test_impulses_are_refused_where_they_cannot_be(small_damper: Scene) -> None:
    with pytest.raises(InputError, match=r"pairs\.far_every = 4: 'pefrl' cannot"):
        simulate(on_mesh(small_damper, far_every=4), t_end=0.01, method="pefrl", progress=False)


@pytest.mark.long
@pytest.mark.parametrize("pairs", [{"method": "mesh", "cut_off": "3 D"}, {"method": "direct"}], ids=str)
def test_order_with_impulses(pairs: dict[str, str], small_damper: Scene) -> None:
    """Second order in the step, for impulses at a fixed number of steps."""
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
def test_run_with_friction_or_another_method(small_bed: Scene, small_damper: Scene, method: str) -> None:
    """The far field is then a part of every force, and of the load."""
    scene = rubbing(small_bed) if method == "stormer-verlet" else small_damper
    meshed = simulate(on_mesh(scene), t_end=0.1, method=method, progress=False)
    exact = simulate(scene, t_end=0.1, method=method, progress=False)
    assert meshed.settings()["ledger_residual"] < 1e-3
    forces = [run.dataset["piston_force"].values[:50] for run in (meshed, exact)]
    np.testing.assert_allclose(*forces, rtol=5e-3)
