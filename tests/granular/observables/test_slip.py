"""Sudden force drops, and plastic and elastic strain in synthetic sequences with prescribed dislocations."""

import numpy as np
import pytest

from granular.observables import (
    drop_statistics,
    elastic_strain,
    plastic_distortion,
    plastic_events,
    voronoi_cells,
)
from granular.observables.plasticity import (
    areal_strain,
    axial_strain_difference,
    glide_displacement_to_edge,
    mask_of_grains_with_interior_neighbours,
    slip_area_tensor,
)
from granular.shared.errors import InputError

from .conftest import MakeRun, hexagonal, rotated
from .test_defect_motion import FILMS, SPACING


def frames_of(name: str) -> np.ndarray:
    _, film = FILMS[name]
    random = np.random.default_rng(3)
    return SPACING * np.array([film(k, random) for k in range(40)])


def area_of(frames: np.ndarray) -> float:
    cells = [voronoi_cells(one) for one in frames[::13]]
    return float(np.mean([one.area[mask_of_grains_with_interior_neighbours(one)].sum() for one in cells]))


def check(name: str, error: float = 0.06) -> None:
    """Assert that the plastic distortion is the sum of b (z x d)/A over the prescribed dislocations.

    Here b is the Burgers vector, d the displacement from first to last frame, and A the area.
    """
    made, _ = FILMS[name]
    frames = frames_of(name)
    found = plastic_distortion(frames)
    driven = sum(
        slip_area_tensor(SPACING * one.burgers, SPACING * (one.place(one.last) - one.start)) for one in made
    )
    wanted = np.asarray(driven) / area_of(frames)
    np.testing.assert_allclose(found.moves[-1], wanted, atol=error * np.abs(wanted).max())


def test_glide_of_dislocations_gives_the_prescribed_plastic_shear() -> None:
    check("glide with jitter")


def test_climb_of_a_dislocation_changes_the_area_and_glide_does_not() -> None:
    """The extra half row above the core becomes shorter as the core moves up."""
    right, up = np.array([1.0, 0.0]), np.array([0.0, 1.0])
    assert areal_strain(slip_area_tensor(right, up)[None])[0] == -1.0
    assert areal_strain(slip_area_tensor(right, right)[None])[0] == 0.0
    assert slip_area_tensor(right, right)[0, 1] == 1.0


def test_displacement_by_which_a_dislocation_glides_to_the_edge_is_along_its_burgers_vector() -> None:
    box = np.array([[0.0, 0.0], [10.0, 6.0]])
    np.testing.assert_allclose(
        glide_displacement_to_edge(np.array([3.0, 2.0]), np.array([1.0, 0.0]), box), [-3.0, 0.0]
    )
    way = glide_displacement_to_edge(np.array([8.0, 5.0]), np.array([-1.0, 1.0]), box)
    np.testing.assert_allclose(way, [-1.0, 1.0])
    assert not glide_displacement_to_edge(np.array([11.0, 2.0]), np.array([1.0, 0.0]), box).any()


def test_elastic_strain_follows_lattice_strain_but_not_rotation() -> None:
    lattice = hexagonal(14, 14)
    squeezed = lattice * np.array([1.02, 0.97])
    found = elastic_strain(np.array([lattice, squeezed, rotated(lattice, 0.1)]))
    assert axial_strain_difference(found)[1] == pytest.approx(np.log(0.97 / 1.02), rel=1e-3)
    assert areal_strain(found)[1] == pytest.approx(np.log(0.97 * 1.02), rel=1e-3)
    # The choice of inner bonds depends on the bounding box, which does not rotate with the grains.
    np.testing.assert_allclose(found[2], 0.0, atol=2e-3)
    assert not plastic_distortion(np.array([lattice, squeezed])).total.any()
    assert np.isnan(elastic_strain(lattice[None, :4])).all()
    with pytest.raises(InputError, match="0 frames"):
        elastic_strain(lattice[None][:0])
    with pytest.raises(InputError, match="a frame has 0 grains"):
        plastic_distortion(np.array([lattice, np.nan * lattice]))


def test_plastic_events_are_found_at_the_times_and_with_the_drops_of_a_sawtooth_force() -> None:
    values = np.array([0.0, 1.0, 0.4, 0.3, 1.5, 1.45, 2.0, 0.0])
    found = plastic_events(np.arange(8.0) * 0.1, values, 0.1)
    assert found.begin.tolist() == [1, 6]
    assert found.end.tolist() == [3, 7]
    np.testing.assert_allclose(found.size, [0.7, 2.0])
    np.testing.assert_allclose(found.time, [0.1, 0.6])
    assert len(plastic_events(np.arange(3.0), np.arange(3.0), 0.1).size) == 0


def test_exponent_of_power_law_distributed_values_is_recovered(random: np.random.Generator) -> None:
    sizes = 0.2 * random.random(20_000) ** (-1.0 / 0.7)
    found = drop_statistics(sizes, 0.2)
    assert abs(found.exponent - 1.7) < 3.0 * found.error
    assert found.error < 0.01
    assert found.events == 20_000


def test_plastic_events_are_found_in_a_run_and_invalid_input_is_refused(make_run: MakeRun) -> None:
    columns = {
        "time": np.arange(4.0),
        "piston_height": np.full(4, 0.3),
        "piston_force": np.array([1.0, 2.0, 1.5, 3.0]),
    }
    run = make_run(0.006 * np.array([hexagonal(5, 5)] * 2), columns=columns)
    force = run.dataset["piston_force"]
    found = plastic_events(force["time"].values, force.values, 0.1)
    assert found.size.tolist() == [0.5]
    with pytest.raises(InputError, match="smallest_drop = 0;"):
        plastic_events(np.arange(2.0), np.arange(2.0), 0.0)
    with pytest.raises(InputError, match="not finite"):
        plastic_events(np.arange(2.0), np.array([1.0, np.nan]), 1.0)
    with pytest.raises(InputError, match=r"drops have the shape \(2,\)"):
        drop_statistics(np.array([1.0, np.nan]), 1.0)
