"""Sums over pairs within a cut-off include all pairs while grains move; resumed sums are bit-identical."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from granular import Scene
from granular.compiled import entry
from granular.pairs import cut_off_sum as cut_off
from granular.pairs.direct_sum import pad_coordinates, pad_values
from granular.pairs.grain_arrays import GrainArrays
from granular.pairs.pure_python_sums import pure_python_cut_off_sum
from granular.pairs.stripes import BUILDS, LISTED, Stripes, allocate_stripes
from granular.shared.errors import SceneError

cut_off_sum = entry(cut_off.cut_off_sum)


def scattered(count: int, seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(count)))
    slot = np.stack([np.arange(count) % side, np.arange(count) // side], axis=1)
    return 1.8 * slot + random.uniform(-0.5, 0.5, (count, 2))


class Bed:
    """Grains, and the arrays for sums over their pairs.

    By default, only the short-range part of a mesh sum is computed.
    """

    smooth: bool | None = True
    threaded: bool | None = None

    def __init__(self, positions: np.ndarray, radius: float, *, differing: bool) -> None:
        self.count, self.near_pair_radius = len(positions), radius
        self.x, self.y = pad_coordinates(positions)
        self.moments = pad_values(np.linspace(0.3, 1.0, self.count)) if differing else None
        self.weight = pad_values(np.linspace(0.2, 1.0, self.count))
        self.stripes = self.workspace()

    def workspace(self) -> Stripes:
        return allocate_stripes(self.x.size, moments=self.moments is not None, with_loads=True)

    def sums(self, function=cut_off_sum) -> np.ndarray:
        out, extremes = np.zeros((4, self.x.size)), np.zeros(2)
        function(
            self.stripes,
            self.near_pair_radius,
            self.smooth,
            self.threaded,
            self.count,
            GrainArrays(self.x, self.y, out[0], out[1], self.moments, out[2], extremes, out[3], self.weight),
        )
        return np.concatenate([out[:, : self.count].ravel(), extremes])


@settings(max_examples=10, deadline=None)
@given(
    count=st.integers(1, 150),
    seed=st.integers(0, 10**6),
    radius=st.floats(0.5, 12.0),
    stretch=st.sampled_from([(1.0, 1.0), (30.0, 0.1), (0.05, 20.0)]),
)
def test_cut_off_sum_equals_the_plain_python_sum_while_grains_move(
    count: int, seed: int, radius: float, stretch: tuple[float, float]
) -> None:
    """Most grains are slow, one crosses several list margins in a step, and once the whole bed jumps."""
    bed = Bed(scattered(count, seed) * stretch, radius, differing=True)
    random = np.random.default_rng(seed)
    for move in (0.0, 0.01, 0.1, 0.0, 3.0):
        bed.x[:count] += random.uniform(-move, move, count)
        bed.y[:count] += random.uniform(-move, move, count)
        bed.x[random.integers(count)] += 20.0 * move
        fast, slow = bed.sums(), bed.sums(pure_python_cut_off_sum)
        scale = np.abs(slow).max()
        np.testing.assert_allclose(fast, slow, rtol=0, atol=1e-12 * scale + 1e-150)


def test_pair_lists_are_rebuilt_only_after_a_grain_has_moved_by_half_the_list_margin() -> None:
    bed = Bed(scattered(150, 4), 6.0, differing=True)
    for _ in range(20):
        bed.sums()
    assert bed.stripes.memory[BUILDS] == 1.0
    bed.x[7] += 3.0
    bed.sums()
    assert bed.stripes.memory[BUILDS] == 2.0


def test_pair_sums_after_a_restored_checkpoint_are_bit_identical() -> None:
    """The checkpoint contains the data that determine the order of the sums."""
    bed = Bed(scattered(300, 9), 6.0, differing=True)
    random = np.random.default_rng(1)
    drift = random.normal(0.0, 2e-2, (2, 300))
    kept: list[np.ndarray] = []
    kept_place, at = None, []
    for step in range(40):
        bed.x[:300] += drift[0]
        bed.y[:300] += drift[1]
        at.append(bed.sums())
        if step == 20:
            kept = [bed.stripes.built.copy(), bed.stripes.memory.copy()]
            kept_place = (bed.x.copy(), bed.y.copy())
    assert bed.stripes.memory[BUILDS] > 5.0
    bed.stripes = bed.workspace()
    bed.stripes.built[:], bed.stripes.memory[:] = kept
    bed.stripes.memory[LISTED] = 0.0  # as a checkpoint restores it
    assert kept_place is not None
    bed.x, bed.y = kept_place
    for wanted in at[21:]:
        bed.x[:300] += drift[0]
        bed.y[:300] += drift[1]
        np.testing.assert_array_equal(bed.sums(), wanted)


def test_nan_positions_give_nan_forces() -> None:
    bed = Bed(scattered(30, 9), 6.0, differing=True)
    bed.y[3] = np.nan
    assert np.isnan(bed.sums()[:60]).all()


def test_scene_keys_select_the_pair_sum_and_its_cut_off(bed: Scene) -> None:
    assert bed.pair_method == "direct"
    assert bed.pairs.near_pair_radius("direct", 0.006) is None
    assert bed.replace(**{"pairs.method": "cut-off"}).pair_method == "cut-off"
    assert bed.pairs.near_pair_radius("cut-off", 0.006) == 11.26
    near = bed.replace(**{"pairs": {"method": "cut-off", "cut_off": "5 D"}})
    assert near.pairs.near_pair_radius("cut-off", 0.006) == pytest.approx(5.0)
    with pytest.raises(SceneError, match=r"pairs\.cut_off: applies only to the methods"):
        bed.replace(**{"pairs.cut_off": "5 D"})
