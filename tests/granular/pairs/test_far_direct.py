"""The far part of the law by a direct sum, found less often than the near part."""

import numpy as np
import pytest

from granular.compiled import entry
from granular.pairs import far_field
from granular.pairs.dipole_law import far_part_of_inverse_cube, far_part_of_inverse_fifth
from granular.pairs.direct_sum import pad_coordinates, pad_values
from granular.pairs.far_field import direct_far_field_workspace
from granular.pairs.grain_arrays import GrainArrays
from granular.pairs.pair_sum_settings import SPLIT_RADIUS as RADIUS
from granular.pairs.stripes import stripes_workspace

compute_direct_far_field = entry(far_field.compute_direct_far_field)
COUNT, WIDTH = 150, 30.0


def places() -> np.ndarray:
    """No two grains closer than one diameter: a grid that is stirred."""
    across = int(np.sqrt(COUNT)) + 1
    grid = np.array([(k % across, k // across) for k in range(COUNT)]) * WIDTH / across
    return np.asarray(grid + np.random.default_rng(3).uniform(-0.4, 0.4, grid.shape))


WEIGHTS = np.random.default_rng(5).uniform(0.3, 0.8, COUNT)


def found() -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """Forces, energy and loads of the far part, and the moments."""
    moments = np.random.default_rng(4).choice([0.36, 1.0], COUNT)
    x, y = pad_coordinates(places())
    fx, fy, load, energy = np.zeros_like(x), np.zeros_like(x), np.zeros_like(x), np.zeros(1)
    compute_direct_far_field(
        direct_far_field_workspace(x.size, with_loads=True),
        stripes_workspace(x.size, moments=True, with_loads=True),
        RADIUS,
        None,
        COUNT,
        GrainArrays(x, y, fx, fy, pad_values(moments), load=load, weight=pad_values(WEIGHTS)),
        energy,
    )
    forces = np.column_stack([fx[:COUNT], fy[:COUNT]])
    return forces, float(energy[0]), load[:COUNT], moments


def test_it_is_the_sum_of_the_far_law_over_all_pairs() -> None:
    forces, energy, load, q = found()
    apart = places()[:, None] - places()[None]
    square, products = (apart**2).sum(axis=2), q[:, None] * q[None]
    wanted = 0.75 * ((products * far_part_of_inverse_fifth(square, RADIUS))[..., None] * apart).sum(axis=1)
    cubes = far_part_of_inverse_cube(square, RADIUS)
    np.fill_diagonal(cubes, 0.0)
    # Taken as a difference: what is left is rounded as the whole forces of close pairs are.
    np.testing.assert_allclose(forces, wanted, atol=1e-13)
    assert energy == pytest.approx(0.125 * (products * cubes).sum(), rel=1e-11)
    np.testing.assert_allclose(forces.sum(axis=0), 0.0, atol=1e-13)  # action and reaction
    np.testing.assert_allclose(load, cubes @ WEIGHTS, rtol=1e-11)
