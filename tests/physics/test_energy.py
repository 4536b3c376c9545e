"""Energy balance: conservation, dissipation, work, and the order of its error in the time step."""

import numpy as np
import pytest
from scipy.stats import linregress

from granular import Scene, Trajectory, evaluate, simulate

STORED = ("kinetic_energy", "pair_energy", "wall_energy", "weight_energy", "piston_energy")


def ledger(run: Trajectory) -> tuple[np.ndarray, float]:
    """Return the error of the energy balance at each record [J], and the maximum energy converted [J]."""
    data = run.dataset
    stored = np.sum([data[name].values for name in STORED if name in data], axis=0)
    lost = data["drag_loss"].values if "drag_loss" in data else 0.0
    work = data["work"].values if "work" in data else 0.0
    potential = stored - data["kinetic_energy"].values
    moved = data["kinetic_energy"].values + np.abs(potential - potential[0]) + lost + np.abs(work)
    return stored - stored[0] + lost - work, float(moved.max())


def test_energy_of_a_bed_under_a_held_piston_is_conserved(bed: Scene) -> None:
    """Over 1e5 steps of 1e-5 s, the energy is constant to 1e-6 and shows no trend."""
    # No drag, by its coefficient: as other beds that are compiled already.
    scene = bed.replace(**{"effects.drag.coefficient": 0.0, "grains.count": 92})
    scene = scene.replace(**{"cell.width": "15 D"})
    run = simulate(scene, dt=1e-5, t_end=1.0, progress=False)
    assert run.settings()["steps"] == 100_000
    residual, _ = ledger(run)
    total = np.sum([run.dataset[name].values for name in STORED if name in run.dataset], axis=0)[0]
    assert np.abs(residual).max() < 1e-6 * total
    # Behind the first tenth, in which the grid melts, block means scatter about a level.
    settled = residual[len(residual) // 10 :]
    means = np.array([block.mean() for block in np.array_split(settled, 20)])
    trend = linregress(np.arange(20), means)
    assert abs(trend.slope) < 4.0 * trend.stderr or abs(trend.slope) * 20 < 1e-8 * total


def test_work_to_lift_the_piston_equals_the_change_of_energy(small_damper: Scene) -> None:
    """The work changes the piston's potential energy, and the energy of its repulsion by the grains."""
    # In more drag it rests sooner.
    scene = small_damper.replace(**{"protocol.release.duration": 0.05, "effects.drag.coefficient": 0.5})
    run = simulate(scene, dt=2e-5, progress=False)
    data = run.dataset
    work, stage = data["work"].values, data["stage"].values
    assert (work[stage == 0] == 0.0).all()
    lifted = work[stage > 0]
    assert (lifted == lifted[0]).all()
    at_rest = int(np.flatnonzero(data["frame_time"].values <= run.stage("drop").end)[-2])
    height = float(data["frame_height"][at_rest])
    positions, by = data["position"].values[at_rest], 0.2 * 0.006
    energies = [
        evaluate(scene, positions, piston_height=one).potential_energy for one in (height, height + by)
    ]
    speed = float(data["piston_velocity"][np.flatnonzero(stage == 0)[-1]])
    change = energies[1] - energies[0] + 1.0 * 9.8 * by - 0.5 * 1.0 * speed**2
    assert lifted[0] == pytest.approx(change, rel=1e-9)
    residual, moved = ledger(run)
    assert np.abs(residual).max() < 1e-4 * moved


@pytest.fixture(scope="module")
def falling(bed: Scene) -> Scene:
    """Return a grain with gravity and drag.

    Shaking of zero amplitude allows the compiled code of other tests to be used.
    """
    return bed.replace(
        **{
            "grains.count": 1,
            "effects.dipole": None,
            "effects.walls": None,
            "effects.shaking": {"amplitude": 0.0, "frequency": 20.0},
            "piston": None,
            "arrangement.positions": [["5 D", "12 D"]],
        }
    )


def test_overdamped_grain_sinks_at_terminal_speed(falling: Scene) -> None:
    """The grain moves at m g/gamma although the time step h is so long that gamma h/m = 1.6e4."""
    run = simulate(falling.replace(**{"effects.drag.coefficient": 1e4}), dt=1e-3, t_end=0.1, progress=False)
    mass = 7368.0 * np.pi * 0.003 * 0.006**2 / 4.0
    speed = run.dataset["velocity"].values[-1, 0, 1]
    assert speed == pytest.approx(-mass * 9.8 / 1e4, rel=1e-9)
