"""The far field where grains rub: found again in time, and the same bits resumed."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from granular import Scene, plan, simulate
from granular.compiled import entry
from granular.engine.forces import add_far_field, refresh_far_field
from granular.kernel_data.state import Bed
from granular.methods import method_named
from granular.pairs.far_field import AHEAD, STILL, TIME
from granular.run.protocol_runner import ProtocolRunner
from granular.run.run_state import ARRANGE
from granular.scene.scene_in_natural_units import scene_in_natural_units

evaluate_far = entry(refresh_far_field)
add_far = entry(add_far_field)


def on_mesh(scene: Scene, **changes: object) -> Scene:
    return scene.replace(**{"pairs": {"method": "mesh", "cut_off": "3 D", **changes}})


def spared(scene: Scene, **changes: object) -> Scene:
    """The direct sum, whose far pairs are met less often."""
    return scene.replace(**{"pairs": {"method": "direct", "far_every": 8, **changes}})


Far = Callable[..., Scene]
both = pytest.mark.parametrize("far", [on_mesh, spared])


def rubbing(scene: Scene) -> Scene:
    return scene.replace(**{"effects.friction": {}})


def moving(scene: Scene) -> Scene:
    """Its grains slide, and nothing else takes their energy."""
    return scene.replace(**{"effects.drag": None, "effects.gravity": None, "arrangement.speed": "2 D/s"})


@pytest.mark.long
def test_far_field_stays_where_grains_that_rub_hardly_move(small_bed: Scene) -> None:
    """It is found again for a grain that moves on, whichever and however it moves."""
    method = method_named("stormer-verlet")
    scene = on_mesh(rubbing(small_bed))
    system = scene_in_natural_units(scene, method=method)
    run = ProtocolRunner(plan(scene, threads=1))
    run.begin_stage()
    state, far = run.state, run.state.far_forces
    assert far is not None
    before = far.fx.copy()
    for by, finds in ((0.4 * STILL, False), (-0.8 * STILL, False), (1.6 * STILL, True)):
        for places in (state.x, state.y):
            far.fx[:] = before
            start = places.copy()
            places[5] += by
            evaluate_far(far, Bed(state, run.constants), 0.0)
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
def test_far_field_goes_on_as_it_changed_while_grains_slide(small_bed: Scene) -> None:
    """Forces and loads to second order, in `AHEAD` steps at most; then they are found again."""
    dt, speed = 0.02, 0.3

    def force_of(rubs: int | None, steps: int) -> tuple[np.ndarray, float]:
        """Far part of force and load after steps at constant speed, and when it was last found."""
        run = ProtocolRunner(plan(on_mesh(rubbing(small_bed), far_every=rubs or 1), threads=1))
        run.begin_stage()
        state, constants = run.state, run.constants
        assert state.far_forces is not None
        assert state.load is not None
        way = speed * np.random.default_rng(4).standard_normal((2, constants.grains))
        for step in range(steps + 1):
            assert evaluate_far(state.far_forces, Bed(state, constants), dt * step) == 0
            if step < steps:
                state.x[: constants.grains] += dt * way[0]
                state.y[: constants.grains] += dt * way[1]
        for sums in (state.fx, state.fy, state.load):
            sums[:] = 0.0
        add_far(state.far_forces, state, constants.grains, dt * steps)
        found = np.array([state.fx, state.fy, state.load])
        return found, float(state.far_forces.timing[TIME])

    for steps, met in ((AHEAD, 1), (AHEAD + 1, AHEAD + 1)):
        exact, _ = force_of(None, steps)
        still, when = force_of(AHEAD, met)
        assert when == pytest.approx(met * dt)
        going, when = force_of(AHEAD, steps)
        assert when == pytest.approx(met * dt)
        if steps > met:
            left = np.abs(going - exact).max(axis=1)
            assert (left < 0.3 * np.abs(still - exact).max(axis=1)).all()
        else:
            np.testing.assert_allclose(going, exact, atol=1e-15)


@both
@pytest.mark.long  # quick: how the far field goes on
def test_order_where_grains_slide(far: Far, small_bed: Scene) -> None:
    """Second order in the step also where the far field goes on for some steps."""
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
def test_bed_that_rubs_rests_under_the_same_force(far: Far, small_bed: Scene) -> None:
    """As with the far field found at every step, and grains that stick stand still exactly."""
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
def test_a_resumed_run_has_the_bits_of_one_in_a_piece(far: Far, small_bed: Scene, tmp_path: Path) -> None:
    """What the far field goes on from is made of the state alone, wherever a run is cut."""
    scene = moving(far(rubbing(small_bed)))
    integer = simulate(scene, t_end=0.05, progress=False).dataset
    for end in (0.0123, 0.0307, 0.05):
        parts = simulate(scene, t_end=end, out=str(tmp_path), resume=end > 0.02, progress=False).dataset
    for name in ("position", "velocity", "force"):
        np.testing.assert_array_equal(integer[name].values[-1], parts[name].values[-1])
