"""De Paula's Verlet list: listed pairs interact at any distance until a grain has moved by the list
margin.
"""

import numpy as np
import pytest

from granular import Scene
from granular.compiled import entry
from granular.pairs import near_list
from granular.pairs.direct_sum import pad_coordinates, pad_values
from granular.pairs.grain_arrays import GrainArrays
from granular.pairs.near_list import BUILDS, LISTED, NearList, VerletSettings, allocate_verlet_list
from granular.pairs.pure_python_sums import pure_python_cut_off_sum
from granular.shared.errors import SceneError
from tests.granular.pairs.test_cut_off import scattered

sum_pairs_of_verlet_list = entry(near_list.sum_pairs_of_verlet_list)

LISTING = VerletSettings(6.0, 2.0)


def sums(function, near: NearList, count: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    moments = pad_values(np.linspace(0.3, 1.0, count))
    out, extremes = np.zeros((4, x.size)), np.zeros(2)
    arrays = GrainArrays(x, y, out[0], out[1], moments, out[2], extremes, out[3], moments)
    function(near, count, arrays)
    return np.concatenate([out[:, :count].ravel(), extremes])


def test_sum_over_a_new_verlet_list_equals_the_cut_off_sum() -> None:
    x, y = pad_coordinates(scattered(150, 3))
    found = sums(sum_pairs_of_verlet_list, allocate_verlet_list(x.size, LISTING), 150, x, y)

    def plain(near: NearList, *rest: object) -> None:
        pure_python_cut_off_sum(None, near.reach, None, None, *rest)

    wanted = sums(plain, allocate_verlet_list(x.size, LISTING), 150, x, y)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())


def test_pairs_of_the_verlet_list_change_only_after_a_grain_moved_by_the_list_margin() -> None:
    x, y = pad_coordinates(np.array([[0.0, 0.0], [5.9, 0.0], [0.0, 6.1]]))
    known = allocate_verlet_list(x.size, LISTING)
    sums(sum_pairs_of_verlet_list, known, 3, x, y)
    x[1] += 1.9  # beyond the radius, and still on the list
    y[2] -= 1.9  # within the radius, and missed
    force = sums(sum_pairs_of_verlet_list, known, 3, x, y)[:6].reshape(2, 3)
    fraction = 0.3 * 0.65 * 0.75 / 7.8**4
    np.testing.assert_allclose(force, [[-fraction, fraction, 0.0], [0.0, 0.0, 0.0]], atol=1e-15)
    assert known.memory[BUILDS] == 1.0
    y[2] -= 0.2
    assert sums(sum_pairs_of_verlet_list, known, 3, x, y)[3] < 0.0  # the first grain, pushed down
    assert known.memory[BUILDS] == 2.0


def test_verlet_list_restored_from_a_checkpoint_gives_bit_identical_sums() -> None:
    x, y = pad_coordinates(scattered(150, 5))
    known = allocate_verlet_list(x.size, LISTING)
    sums(sum_pairs_of_verlet_list, known, 150, x, y)
    x[:150] += np.random.default_rng(1).uniform(-1.0, 1.0, 150)
    wanted = sums(sum_pairs_of_verlet_list, known, 150, x, y)
    again = allocate_verlet_list(x.size, LISTING)
    again.built[:], again.memory[:] = known.built, known.memory
    again.memory[LISTED] = 0.0  # as a checkpoint restores it
    np.testing.assert_array_equal(sums(sum_pairs_of_verlet_list, again, 150, x, y), wanted)


def test_verlet_list_with_too_many_pairs_gives_nan_forces() -> None:
    x, y = pad_coordinates(scattered(60, 5))
    workspace = allocate_verlet_list(x.size, LISTING)
    full = workspace._replace(partners=np.zeros(9, dtype=np.uint32))
    assert np.isnan(sums(sum_pairs_of_verlet_list, full, 60, x, y)[:120]).all()


def test_scene_keys_select_the_verlet_list(bed: Scene) -> None:
    source = bed.replace(**{"pairs.method": "verlet-list"})
    assert source.pairs.verlet_list_settings(0.006) == (11.26, 4.13)
    assert source.pairs.near_pair_radius("verlet-list", 0.006) is None
    assert source.pair_method == "verlet-list"
    with pytest.raises(SceneError, match=r"pairs\.skin: applies only to the method 'verlet-list'"):
        bed.replace(**{"pairs.skin": "1 D"})
