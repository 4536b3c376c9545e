"""Dry friction: normal load, sticking, stopping and energy balance, for both friction schemes."""

import numpy as np
import pytest

from granular import Scene, evaluate, load_scene, simulate
from granular.shared.errors import SceneError

MASS = 7368.0 * np.pi * 0.003 * 0.006**2 / 4.0


def lone_grain(**changes: object) -> Scene:
    """Return a scene of one grain with a constant normal load and no other force."""
    return load_scene("bed").replace(
        **{
            "grains.count": 1,
            "grains.species": [
                {"name": "dense", "diameter": 0.006, "share": 0.1, "density": 16000.0},
                {"name": "disc", "diameter": 0.006, "share": 0.9},
            ],
            "effects.dipole": None,
            "effects.walls": None,
            "effects.gravity.acceleration": 0.0,
            "effects.drag.coefficient": 0.0,
            "piston": None,
            "effects.friction.load": 0.01,
            "arrangement.positions": [["30 D", "10 D"]],
            "protocol": [{"kind": "hold", "name": "slide", "duration": 1.0}],
            "output.scalars": 1e-3,
            "output.frames": 0.05,
            **changes,
        }
    )


@pytest.mark.parametrize(
    ("diameter", "torque", "wanted"),
    [(0.006, "first", 0.0126585), (0.005, "first", 0.0152756), (0.006, "second", 0.0168786)],
)
def test_normal_load_of_two_grains_agrees_with_the_documented_formula(
    diameter: float, torque: str, wanted: float
) -> None:
    """N = K/r^3 in natural units, the same for both grains."""
    scene = load_scene("bed").replace(
        **{"grains.species.0.diameter": diameter, "grains.count": 2, "effects.friction.torque": torque}
    )
    r = 2.5
    load = evaluate(scene, np.array([[0.1, 0.05], [0.1 + r * diameter, 0.05]])).normal_load
    from granular.schema.natural_units import Scales

    natural = load / Scales.from_grains(scene.grains).force * r**3
    assert natural == pytest.approx([wanted, wanted], rel=5e-6)


def torques_of_tilted_dipoles(places: np.ndarray, tilts: np.ndarray, moments: np.ndarray) -> np.ndarray:
    """Return the torque on the first dipole, at the origin, for small tilts (n, 2), in units of mu0
    m1^2/(4 pi).
    """
    r = np.linalg.norm(places[1:], axis=1)
    toward = places[1:] / r[:, None]
    along = np.einsum("ij,ij->i", tilts[1:], toward)
    by = tilts[0] - tilts[1:] + 3.0 * along[:, None] * toward
    return np.asarray((moments[0] * moments[1:] / r**3) @ by)


@pytest.mark.parametrize(("tilt", "part"), [("aligned", 1.0 / 2.0), ("independent", 1.0 / 3.0)])
def test_mean_loads_of_aligned_and_independent_tilts_agree_with_vector_sums_of_torques(
    bed: Scene, tilt: str, part: float
) -> None:
    """In 4000 samples the neighbours are random in all directions.

    The mean torque is along the grain's tilt.
    """
    random = np.random.default_rng(5)
    angle, own = np.radians(0.96), np.array([1.0, 0.0])
    means = []
    for _ in range(4000):
        r, round_about = random.uniform(1.1, 4.0, 30), random.uniform(0.0, 2.0 * np.pi, 30)
        places = np.vstack([np.zeros(2), np.column_stack([r * np.cos(round_about), r * np.sin(round_about)])])
        direction = random.uniform(0.0, 2.0 * np.pi, 31) * (tilt == "independent")
        direction[0] = 0.0
        tilts = angle * np.column_stack([np.cos(direction), np.sin(direction)])
        torque = torques_of_tilted_dipoles(places, tilts, np.ones(31)) @ own
        means.append(torque / (3.0 * angle * (r**-3.0).sum()))
    error = np.std(means) / np.sqrt(len(means))
    assert error < 0.01 * part
    assert abs(np.mean(means) - part) < 4.0 * error
    positions = bed.initial_positions_and_velocities()[0]
    loads = [
        evaluate(bed.replace(**{"effects.friction": changes}), positions).normal_load
        for changes in ({}, {"tilt": tilt})
    ]
    np.testing.assert_allclose(loads[1], part * loads[0], rtol=1e-12)


@pytest.mark.parametrize("dt", [1e-4, 1e-5])
def test_grain_sliding_against_a_force_below_static_friction_sticks(dt: float) -> None:
    """A force between mu_d N and mu_s N against the motion stops the grain permanently."""
    weight, load = 6.2498e-4 * 9.8, 6.2498e-4 * 9.8 / 0.55
    assert 0.45 * load < weight < 0.6 * load
    for speed in np.linspace(0.05, 0.06, 21):
        scene = lone_grain(
            **{
                "arrangement.velocities": [[0.0, float(speed)]],
                "effects.gravity": True,
                "effects.friction": {"load": load},
                "protocol": [{"kind": "hold", "name": "slide", "duration": 0.05}],
            }
        )
        run = simulate(scene, dt=dt, progress=False)
        velocity = run.dataset["velocity"].values[-1, 0]
        assert (velocity == 0.0).all(), speed


@pytest.mark.parametrize("dt", [1e-5, 3.7e-5])
def test_sliding_grain_stops_at_the_exact_distance(dt: float) -> None:
    """The distance is m v^2/(2 mu_d N), and the grain then stays exactly at rest."""
    speed, load = 0.1, 0.01
    scene = lone_grain(**{"arrangement.velocities": [[0.6 * speed, 0.8 * speed]]})
    run = simulate(scene, dt=dt, progress=False)
    place = run.dataset["position"].values[:, 0]
    distance = np.linalg.norm(place[-1] - place[0])
    exact = MASS * speed**2 / (2.0 * 0.45 * load)
    assert distance == pytest.approx(exact, rel=1e-6)
    stopped = speed * MASS / (0.45 * load)
    still = place[run.dataset["frame_time"].values > stopped + dt]
    assert len(still) > 5
    assert (still == still[0]).all()
    assert run.dataset["friction_loss"].values[-1] == pytest.approx(0.5 * MASS * speed**2, rel=1e-9)


def test_grain_whose_weight_is_below_static_friction_stays_exactly_at_rest() -> None:
    """The weight is 0.1 % below mu_s N; the run lasts one second."""
    load = 0.01
    scene = lone_grain(**{"effects.gravity.acceleration": 0.999 * 0.6 * load / MASS})
    run = simulate(scene, dt=1e-5, progress=False)
    assert run.settings()["steps"] == 100_000
    place = run.dataset["position"].values[:, 0]
    assert (place == place[0]).all()
    assert (run.dataset["kinetic_energy"].values == 0.0).all()
    assert (run.dataset["friction_loss"].values == 0.0).all()


def test_grain_whose_weight_is_above_static_friction_slides_with_dynamic_friction() -> None:
    load = 0.01
    gravity = 1.001 * 0.6 * load / MASS
    scene = lone_grain(
        **{"effects.gravity.acceleration": gravity, "arrangement.positions": [["30 D", "300 D"]]}
    )
    run = simulate(scene, dt=1e-4, t_end=0.2, progress=False)
    fall = 1.8 - run.dataset["position"].values[-1, 0, 1]
    assert fall == pytest.approx(0.5 * (gravity - 0.45 * load / MASS) * 0.04, rel=1e-9)


def test_grain_with_friction_and_drag_stops_at_the_time_of_the_closed_form() -> None:
    """With v' = -c v - b, a grain of initial speed v stops after ln(1 + c v/b)/c."""
    load, gamma, speed = 0.01, 0.02, 0.2
    scene = lone_grain(**{"effects.drag.coefficient": gamma, "arrangement.velocities": [[speed, 0.0]]})
    c, b = gamma / MASS, 0.45 * load / MASS
    time = np.log1p(c * speed / b) / c
    distance = (speed - b * time) / c
    errors = []
    for dt in (2e-4, 1e-4, 5e-5):
        run = simulate(scene, dt=dt, t_end=2.0 * time, progress=False)
        place = run.dataset["position"].values[:, 0, 0]
        errors.append(abs(place[-1] - place[0] - distance))
    assert errors[-1] < 1e-5 * distance
    assert errors[0] / errors[-1] > 8.0


@pytest.mark.parametrize("gamma", [0.0, 0.05])
def test_grain_thrown_upwards_slides_back_if_its_weight_exceeds_static_friction(gamma: float) -> None:
    """It turns without sticking, for any time step."""
    load, speed, g = 0.005, 0.1, 9.8
    b, c = 0.45 * load / MASS, gamma / MASS
    scene = lone_grain(
        **{
            "effects.gravity.acceleration": g,
            "effects.drag.coefficient": gamma,
            "effects.friction.load": load,
            "arrangement.velocities": [[0.0, speed]],
        }
    )
    if gamma == 0.0:
        up = speed / (g + b)
        top = 0.5 * speed * up
        down = 0.5 * (g - b) * (0.03 - up) ** 2
    else:
        up = np.log1p(c * speed / (g + b)) / c
        top = (speed - (g + b) * up) / c
        down = (g - b) / c * ((0.03 - up) + np.expm1(-c * (0.03 - up)) / c)
    errors = []
    for dt in (1e-3, 5e-4, 2.5e-4):
        each = scene.replace(**{"output.scalars": dt, "output.frames": dt})
        run = simulate(each, dt=dt, t_end=0.03, progress=False)
        lost = run.dataset["friction_loss"].values
        assert (np.diff(lost) >= 0.0).all()
        place = run.dataset["position"].values[:, 0, 1]
        errors.append(abs(place[-1] - place[0] - (top - down)))
        assert lost[-1] == pytest.approx(0.45 * load * (top + down), rel=0.05 * dt / 2.5e-4)
    # Second order, with a phase of the turn that differs from step to step.
    assert (np.array(errors) < (g + b) * np.array([1e-3, 5e-4, 2.5e-4]) ** 2).all()


@pytest.mark.long  # quick: one grain stops to the last bit, above
def test_bed_with_friction_comes_exactly_to_rest(small_bed: Scene) -> None:
    scene = small_bed.replace(
        **{
            "effects.drag": None,
            "effects.friction": {},
            "protocol.settle.until": "rest",
            "protocol.settle.duration": 20.0,
        }
    )
    run = simulate(scene, progress=False)
    assert run.stages[0].reason == "rest"
    assert run.dataset["kinetic_energy"].values[-1] == 0.0
    force = run.dataset["force"].values[-1]
    load = run.dataset["normal_load"].values[-1]
    assert (np.linalg.norm(force, axis=1) <= 0.6 * load * (1 + 1e-12)).all()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"effects.friction.dynamic": 0.7}, "exceeds the static coefficient"),
        ({"effects.friction.scheme": "sticky"}, "unknown choice"),
        ({"effects.friction.torque": "second", "effects.friction.tilt": "aligned"}, "use 'first'"),
        ({"effects.friction.load": -1.0}, "at least 0 N"),
        ({"cell.separation": 0.0029}, "is below the grains' thickness"),
        ({"grains.species.0.diameter": 0.0007, "arrangement.height": 0.1}, "tips over"),
    ],
)
def test_invalid_friction_parameters_are_an_error(bed: Scene, changes: dict, words: str) -> None:
    with pytest.raises(SceneError) as caught:
        bed.replace(**{"effects.friction": {}}).replace(**changes)
    assert words in str(caught.value)


@pytest.mark.parametrize("torque", ["first", "second"])
def test_grains_too_small_to_have_a_tilt_angle_between_the_plates_are_refused(torque: str) -> None:
    """The angle exists for diameters above 0.78 mm.

    This limit is sqrt(E^2 - eps^2) for a separation E of the plates and a grain thickness eps.
    """
    bed = load_scene("bed").replace(**{"effects.friction.torque": torque, "grains.count": 2})
    bed.replace(**{"grains.species.0.diameter": 0.00079})
    with pytest.raises(SceneError, match=r"not above 0\.000781 m"):
        bed.replace(**{"grains.species.0.diameter": 0.00078})
