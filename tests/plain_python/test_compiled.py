"""Random scenes and combinations of features from the other files, with compiled code and in larger beds."""

from pathlib import Path

import pytest

pytestmark = [pytest.mark.long, pytest.mark.filterwarnings("ignore::RuntimeWarning")]


@pytest.mark.parametrize("number", range(27))
def test_compiled_sums_of_random_scenes_agree_with_brute_force(number: int) -> None:
    from tests.plain_python.test_drawn_scenes import SCENES, check_case, make_case

    check_case(make_case(SCENES[number]))


@pytest.mark.parametrize("part", range(10))
def test_every_pair_of_scene_features_works_in_beds_of_92_and_368_grains(part: int, tmp_path: Path) -> None:
    from tests.plain_python.test_pairs_of_features import FULL, ROWS, check

    for number, row in enumerate(ROWS[part::10]):
        check(row, FULL, tmp_path / str(number))


@pytest.mark.parametrize("number", range(8))
def test_compiled_runs_are_bit_identical_although_lists_of_near_pairs_are_rebuilt_on_resuming(
    number: int, tmp_path: Path
) -> None:
    """A run in three parts and a run on two threads are compared with an uninterrupted run."""
    from tests.plain_python.test_orders_and_bits import RESUMED, check_bits

    check_bits(list(RESUMED)[number], tmp_path)
