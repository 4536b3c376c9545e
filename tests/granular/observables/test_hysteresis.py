"""Work over a cycle, and the forces of a run."""

import numpy as np
import pytest

from granular import Scene, Trajectory, simulate
from granular.observables import hysteresis_cycles, hysteresis_energy, packing_fraction_series, wall_forces
from granular.observables.forces import piston_force
from granular.observables.harmonics import cycle_bounds
from granular.shared.errors import InputError

from .conftest import MakeRun


def test_loop_of_known_area() -> None:
    """An ellipse with the half axes 2 m and 3 N, run so that the force is larger going down."""
    turn = np.linspace(0.0, 2.0 * np.pi, 4001)
    height, force = 5.0 + 2.0 * np.cos(turn), 10.0 + 3.0 * np.sin(turn)
    assert hysteresis_energy(height, force) == pytest.approx(6.0 * np.pi, rel=1e-5)
    assert hysteresis_energy(height[::-1], force[::-1]) == pytest.approx(-6.0 * np.pi, rel=1e-5)


def test_elastic_bed_has_no_hysteresis(random: np.random.Generator) -> None:
    height = np.concatenate([np.linspace(2.0, 1.0, 60), np.linspace(1.0, 2.0, 90)])
    assert hysteresis_energy(height, 4.0 * height) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("top", [1.6, 2.3])
def test_open_cycle_is_closed_at_the_lower_top(top: float) -> None:
    """Force 5 down and 3 up between 1 and the lower of both tops: 2 (top - 1)."""
    down, up = np.linspace(2.0, 1.0, 7), np.linspace(1.0, top, 11)
    height = np.concatenate([down, up])
    force = np.concatenate([np.full(7, 5.0), np.full(11, 3.0)])
    assert hysteresis_energy(height, force) == pytest.approx(2.0 * (min(top, 2.0) - 1.0), rel=1e-12)


def test_cycles_are_told_apart() -> None:
    leg = np.linspace(2.0, 1.0, 50)
    rest = np.full(20, 2.0)
    height = np.concatenate([rest, leg, leg[::-1], rest, leg, leg[::-1], rest])
    found = cycle_bounds(height)
    assert [height[one.lowest] for one in found] == [1.0, 1.0]
    assert [(one.start, one.stop) for one in found] == [(20, 119), (139 + 1, 239)]
    jitter = height + 0.002 * np.sin(np.arange(len(height)))
    assert len(cycle_bounds(jitter)) == 2
    assert len(cycle_bounds(-np.cos(np.linspace(0.0, 6.0 * np.pi, 500)))) == 2
    assert cycle_bounds(np.ones(5)) == []
    assert cycle_bounds(leg) == []
    assert cycle_bounds(np.array([])) == []


@pytest.fixture(scope="module")
def cycle(small_bed: Scene) -> Trajectory:
    """A small bed, compressed and expanded twice."""
    return simulate(
        small_bed.replace(
            protocol=[
                {"name": "settle", "kind": "hold", "duration": 0.5},
                {"name": "down", "kind": "move", "to": "4 D", "speed": "40 mm/s"},
                {"name": "up", "kind": "move", "to": "6 D", "speed": "40 mm/s"},
                {"name": "down again", "kind": "move", "to": "5 D", "speed": "40 mm/s"},
                {"name": "up again", "kind": "move", "to": "6 D", "speed": "40 mm/s"},
            ]
        ),
        progress=False,
    )


def test_energy_of_a_run_is_the_work_from_outside(cycle: Trajectory) -> None:
    """The ledger integrates the same work step by step; the records are a millisecond apart."""
    found = hysteresis_cycles(cycle)
    assert found.sizes["cycle"] == 2
    time, work = cycle.dataset["time"].values, cycle.dataset["work"].values
    for k in range(2):
        first = np.flatnonzero(time == float(found["start"][k]))[-1]
        last = np.flatnonzero(time == float(found["stop"][k]))[0]
        spent = work[last] - work[first]
        turned_over = np.abs(np.diff(work[first : last + 1])).sum()
        assert float(found["energy"][k]) == pytest.approx(spent, abs=1e-4 * turned_over)
        assert float(found["energy"][k]) > 0.0
    assert found["lowest"].values == pytest.approx([0.024, 0.030])
    assert found["highest"].values == pytest.approx([0.036, 0.036])
    assert found["energy"].attrs["units"] == "J"


def test_forces_and_packing_of_a_run(cycle: Trajectory) -> None:
    forces = wall_forces(cycle)
    assert forces.dims == ("time", "wall")
    assert forces["wall"].values.tolist() == ["left", "right", "bottom", "piston"]
    np.testing.assert_array_equal(forces.sel(wall="piston"), piston_force(cycle))
    np.testing.assert_array_equal(forces.sel(wall="left"), cycle.dataset["left_force"])
    # At rest the bottom carries the piston force and the weight of the grains.
    settled = int(np.searchsorted(cycle.dataset["time"].values, 0.49))
    weight = 23 * 7368.0 * np.pi * 0.003 * 0.006**2 / 4.0 * 9.8
    difference = forces.sel(wall="bottom") - forces.sel(wall="piston")
    assert float(difference[settled]) == pytest.approx(weight, rel=2e-2)
    packing = packing_fraction_series(cycle)
    height = cycle.dataset["piston_height"].values
    np.testing.assert_allclose(packing * height, 23 * np.pi * 0.003**2 / 0.09, rtol=1e-12)


def test_a_scene_without_walls_is_an_input_error(make_run: MakeRun) -> None:
    run = make_run(np.zeros((1, 3, 2)), {"effects.walls": None})
    with pytest.raises(InputError, match="no walls"):
        wall_forces(run)
    with pytest.raises(InputError, match="piston force"):
        hysteresis_cycles(run)
    with pytest.raises(InputError, match="at least 3 samples"):
        hysteresis_energy(np.ones(2), np.ones(2))
