"""The start of a run follows from the parts of a scene alone."""

import dataclasses

import numpy as np
import pytest

from granular.scene.arrangement import Arrangement, check_positions, initial_positions_and_velocities
from granular.schema.apparatus import Grains, Piston, Species
from granular.schema.cell import Cell
from granular.shared.errors import SceneError

GRAINS = Grains(count=23, species=(Species(diameter=0.006),))
CELL = Cell(width=0.09)
PISTON = Piston(height=0.036)


def test_grains_stand_in_the_cell_and_move_at_the_speed_asked_for() -> None:
    plan = Arrangement(seed=3, speed=0.2)
    places, velocities = initial_positions_and_velocities(plan, GRAINS, CELL, PISTON, overlapping=False)
    assert places.shape == velocities.shape == (23, 2)
    assert (places > 0.003).all()
    assert (places < [CELL.width - 0.003, PISTON.height - 0.003]).all()
    assert np.linalg.norm(velocities, axis=1) == pytest.approx(0.2, rel=1e-12)
    other = initial_positions_and_velocities(
        dataclasses.replace(plan, seed=4), GRAINS, CELL, PISTON, overlapping=False
    )
    assert not np.isclose(places, other[0]).any(axis=1).all()


def test_only_grains_in_contact_may_overlap() -> None:
    two = dataclasses.replace(GRAINS, count=2)
    near = Arrangement(positions=((0.02, 0.02), (0.025, 0.02)))
    places, _ = initial_positions_and_velocities(near, two, CELL, PISTON, overlapping=True)
    assert places.tolist() == [[0.02, 0.02], [0.025, 0.02]]
    with pytest.raises(SceneError, match="grains 0 and 1 overlap"):
        initial_positions_and_velocities(near, two, CELL, PISTON, overlapping=False)


def test_a_grid_without_height_needs_a_piston() -> None:
    with pytest.raises(SceneError, match="height: must be given where there is no piston"):
        initial_positions_and_velocities(Arrangement(), GRAINS, CELL, None, overlapping=False)
    plan = Arrangement(height=0.03)
    assert len(initial_positions_and_velocities(plan, GRAINS, CELL, None, overlapping=False)[0]) == 23


@pytest.mark.parametrize("few", [0, 1000])
@pytest.mark.parametrize("height", [None, 0.03])
def test_overlaps_are_those_of_all_pairs(
    height: float | None, few: int, random: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("granular.scene.arrangement.FEW", few)
    cell = Cell(width=0.03) if height is None else Cell(width=0.03, sides="periodic", height=height)
    five, overlapping = dataclasses.replace(GRAINS, count=5), 0
    for _ in range(300):
        positions = 0.003 + 0.024 * random.random((5, 2))
        if height is not None:
            positions = 0.03 * random.random((5, 2))
        gaps = np.linalg.norm(
            cell.nearest_image_displacements(positions[:, None] - positions), axis=2
        ) + np.eye(5)
        if gaps.min() < 0.006:
            overlapping += 1
            with pytest.raises(SceneError, match="overlap"):
                check_positions(positions, five, cell, None, overlapping=False)
        else:
            check_positions(positions, five, cell, None, overlapping=False)
    assert 30 < overlapping < 290
