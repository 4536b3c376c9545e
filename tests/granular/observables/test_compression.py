"""Computed pair and wall forces add up to the engine's forces and satisfy the virial theorem."""

from typing import Any

import numpy as np
import pytest

from granular import Scene, evaluate, load_scene
from granular.observables import (
    compressive_forces,
    force_dip_test,
    force_distribution,
    frame_at,
    grain_pressures,
    grain_stresses,
    grain_virials,
    interaction_forces,
    per_frame,
    voronoi_cells,
)
from granular.observables.forces import iterate_pair_forces, wall_branches_and_forces
from granular.observables.frame import Frame
from granular.shared.errors import InputError
from tests.modes import quick_in_plain_python

from .conftest import MakeRun, hexagonal

WIDTH, HEIGHT, COUNT = 0.08, 0.06, 30
SLAB = {"law": "slab", "length": "0.6 m"}
FORMULA = {"energy": "a*(l/w)**3", "a": "1 uJ", "l": "6 mm"}
TWO = [{"name": "big", "diameter": 0.005, "share": 0.5}, {"name": "small", "diameter": 0.003, "share": 0.5}]


def bed(**changes: Any) -> Scene:
    given = {
        "grains.count": COUNT,
        "grains.species": TWO,
        "cell.width": WIDTH,
        "piston.height": HEIGHT,
        "arrangement.height": 0.058,
        "arrangement.speed": 0,
    }
    return load_scene("bed").replace(**given, **changes)


def places(random: np.random.Generator) -> np.ndarray:
    x, y = np.meshgrid(np.linspace(0.004, 0.076, 6), np.linspace(0.004, 0.056, 5))
    grid = np.stack([x.ravel(), y.ravel()], axis=1)
    return np.asarray(grid + random.uniform(-2e-3, 2e-3, grid.shape))


CHANGES: tuple[dict[str, Any], ...] = (
    {},
    {"effects.walls": dict.fromkeys(("left", "right", "bottom", "top"), "infinite")},
    {"effects.walls": {"left": SLAB, "right": "none", "bottom": "infinite", "top": "slab"}},
    {"effects.walls": {"left": FORMULA}, "grains.spread": 0.1},
    {"effects.contact": {"modulus": "1 MPa"}},
    # For discs without other effects, two of them pressed together: within the error of the tabulated force.
    {
        **{"grains.magnets": "cylinders", "grains.spread": 0.05, "pairs.method": "direct"},
        **{f"effects.{name}": None for name in ("walls", "gravity", "drag")},
        "piston": None,
    },
)


def check_parts(changes: dict[str, Any], random: np.random.Generator) -> None:
    """Assert that pair forces and wall forces add up to the engine's forces."""
    scene, positions = bed().replace(**changes), places(random)
    of_discs = "grains.magnets" in changes
    if "effects.contact" in changes or of_discs:
        positions[1] = positions[0] + [0.00398 if of_discs else 0.0025, 0.0]
    integer = evaluate(scene, positions).force.copy()
    if scene.effects.gravity is not None:
        integer[:, 1] += 9.8 * scene.grains.masses()
    parts = [*iterate_pair_forces(scene, positions)]
    if scene.effects.walls is not None:
        parts.append(wall_branches_and_forces(scene, positions))
    total = np.zeros((COUNT, 2))
    for one in parts:
        total[one.grains] += one.forces.sum(axis=1)
    error = 1e-5 if of_discs else 1e-13
    np.testing.assert_allclose(total, integer, rtol=0.0, atol=error * np.abs(integer).max())


@quick_in_plain_python
def test_pair_and_wall_forces_on_each_grain_add_up_to_the_force_in_the_simulation(
    random: np.random.Generator,
) -> None:
    """Further force laws are tested without compilation in tests/plain_python/test_sums_in_scenes.py."""
    check_parts(CHANGES[0], random)


def test_compressive_force_is_the_sum_of_force_magnitudes(random: np.random.Generator) -> None:
    """The sum is compared with de Paula's formulas, evaluated pair by pair."""
    scene, positions = bed(), places(random)
    moments = 1.3 / (4e-7 * np.pi) * np.pi * 0.003 / 4.0 * scene.grains.diameters() ** 2
    unit = 4e-7 * np.pi * (1.3 / (4e-7 * np.pi) * np.pi * 0.003 * 0.005**2 / 4.0) ** 2
    for i in (0, 7, 29):
        r = np.linalg.norm(positions - positions[i], axis=1)
        r[i] = np.inf
        pairs = 3.0 * 4e-7 * np.pi * moments[i] * moments / (4.0 * np.pi * r**4)
        x, y = positions[i]
        fraction = moments[i] / moments[scene.grains.diameters() == 0.005][0]
        walls = [
            0.5 * fraction * unit / (np.pi * 0.005**4) * (0.005 / w) ** 3.5
            for w in (x, WIDTH - x, y, HEIGHT - y)
        ]
        found = compressive_forces(scene, positions)[i]
        assert found == pytest.approx(pairs.sum() + sum(walls), rel=1e-12)


@quick_in_plain_python
def test_virials_add_up_to_piston_force_times_height(random: np.random.Generator) -> None:
    """Since the positions are not an equilibrium, the virial of the net forces on the grains is added."""
    scene, positions = bed(), places(random)
    found = evaluate(scene, positions)
    own = found.force.copy()
    own[:, 1] += 9.8 * scene.grains.masses()
    total = grain_virials(scene, positions).sum(axis=0)
    upright = HEIGHT * found.piston_force + float(positions[:, 1] @ own[:, 1])
    across = WIDTH * found.wall_forces["right"] + float(positions[:, 0] @ own[:, 0])
    assert total[1, 1] == pytest.approx(upright, rel=1e-12)
    assert total[0, 0] == pytest.approx(across, rel=1e-12)


def test_grain_stress_in_a_crystal_equals_the_lattice_sum() -> None:
    """The stress in an infinite triangular lattice of rho grains per D^2 is 1.6675 (F*/D) rho^2.5.

    The inner grains of a patch are compared with this value.
    """
    spacing, side = 0.012, 46
    positions = hexagonal(side, side, spacing) + 0.1
    scene = load_scene("bed").replace(
        **{
            "grains.count": side * side,
            "cell.width": "1.2 m",
            "piston": None,
            "effects.walls": None,
            "arrangement.height": "1 m",
        }
    )
    cells = voronoi_cells(positions)
    stresses = grain_stresses(scene, positions, cells=cells)
    middle = (side // 2) * side + side // 2
    density = 2.0 / np.sqrt(3.0) * (0.006 / spacing) ** 2
    unit = 4e-7 * np.pi * 0.08775**2 / (np.pi * 0.006**4)
    lattice = 1.6675 * unit / 0.006 * density**2.5
    pressures = grain_pressures(scene, positions, cells=cells)
    # The patch lacks distant neighbours, whose share falls with the patch radius of 23 spacings.
    assert pressures[middle] == pytest.approx(lattice, rel=0.04)
    assert stresses[middle, 0, 0] == pytest.approx(stresses[middle, 1, 1], rel=0.01)
    assert abs(stresses[middle, 0, 1]) < 0.01 * pressures[middle]
    assert np.isnan(pressures[0])


def test_grains_that_have_left_the_cell_exert_no_force(random: np.random.Generator) -> None:
    scene, positions = bed(), places(random)
    positions[3] = np.nan
    found = compressive_forces(scene, positions)
    assert np.isnan(found[3])
    assert np.isfinite(np.delete(found, 3)).all()
    far = positions.copy()
    far[3] = [WIDTH / 2, 1e6]
    without = [next(iterate_pair_forces(scene, one)).forces[0].sum(axis=0) for one in (positions, far)]
    np.testing.assert_allclose(without[0], without[1], rtol=1e-12)


def test_unknown_force_laws_and_arrays_of_wrong_shape_are_input_errors() -> None:
    law = [{"energy": "a*exp(-r/l)", "a": "1 mJ", "l": "2 mm"}]
    with pytest.raises(InputError, match=r"effects\.pair_law: the force of this effect between grains"):
        compressive_forces(bed(**{"effects.pair_law": law}), np.zeros((COUNT, 2)))
    with pytest.raises(InputError, match="7 positions for 30 grains"):
        compressive_forces(bed(), np.zeros((7, 2)))
    with pytest.raises(InputError, match="Voronoi cells of 3 grains for 30 positions"):
        grain_stresses(bed(), np.zeros((COUNT, 2)), cells=voronoi_cells(np.zeros((3, 2))))


@pytest.mark.parametrize("mount", ["cell", "piston"])
@quick_in_plain_python
def test_a_machine_that_carries_the_bed_does_not_change_forces_between_grains(mount: str) -> None:
    """If the machine carries the piston, the cell is inverted and the weight points towards the piston."""
    scene = load_scene("machine")
    if mount == "piston":
        change = {"effects.host.mount": mount, "piston.mass": "1 kg", "effects.host.cell_mass": "1 kg"}
        scene = scene.replace(**change)
    positions = scene.initial_positions_and_velocities()[0]
    assert np.isfinite(grain_virials(scene, positions)).all()
    total = wall_branches_and_forces(scene, positions).forces.sum(axis=1)
    for one in iterate_pair_forces(scene, positions):
        total[one.grains] += one.forces.sum(axis=1)
    grains, height = scene.grains, scene.piston.height
    frame = Frame(
        *(scene, 0.0, positions, 0.0 * positions, evaluate(scene, positions).force, height),
        *(grains.species_indices(), grains.diameters(), grains.masses()),
    )
    found = interaction_forces(frame)
    np.testing.assert_allclose(found, total, rtol=0.0, atol=1e-12 * np.abs(total).max())


def test_force_distributions_of_a_run_agree_with_its_compressive_forces(
    make_run: MakeRun, random: np.random.Generator
) -> None:
    changes = {"grains.species": TWO, "cell.width": "0.08 m", "piston.height": "0.06 m"}
    frames = np.stack([places(random), places(random)])
    run = make_run(frames, changes, heights=np.full(2, HEIGHT))
    forces = per_frame(run, "compressive_force").values
    np.testing.assert_allclose(forces[1], compressive_forces(run.scene, frames[1], HEIGHT))
    pressure = per_frame(run, "grain_pressure").values
    inside = voronoi_cells(frames[1]).interior
    np.testing.assert_array_equal(np.isfinite(pressure[1]), inside)

    owner = run.dataset["species"].values
    for k, one in enumerate(force_distribution(frame_at(run)).values()):
        assert one.counts.sum() == (inside & (owner == k)).sum()
        assert one.edges[-1] == pytest.approx(forces[1, inside & (owner == k)].max())
    (pooled,) = force_distribution(frame_at(run), pooled=True).values()
    assert pooled.counts.sum() == inside.sum()
    assert pooled.edges[-1] == 1.0
    assert 0.0 < force_dip_test(frame_at(run)).p <= 1.0
    with pytest.raises(InputError, match="the run has 2 frames, but no frame 2; use 0 to 1"):
        frame_at(run, 2)


@pytest.mark.parametrize("pooled", [False, True])
def test_force_distribution_without_interior_voronoi_cells_is_refused(
    make_run: MakeRun, pooled: bool
) -> None:
    """A row of grains has no interior cell."""
    row = np.stack([0.006 + 0.0126 * np.arange(6), np.full(6, 0.02)], axis=1)
    changes = {"grains.count": 6, "cell.width": "0.08 m", "piston.height": "0.06 m"}
    run = make_run(row[None], changes, heights=np.array([HEIGHT]))
    with pytest.raises(InputError, match="0 grains with an interior Voronoi cell"):
        force_distribution(frame_at(run), pooled=pooled)
