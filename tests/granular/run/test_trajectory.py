"""Two records of one time: told apart in labelled data, and joined again."""

import numpy as np
import pytest

from granular.run.trajectory import merge_equal_times, separate_equal_times


@pytest.mark.parametrize("times", [[0.0], [0.0, 0.1, 0.2], [0.0, 0.1, 0.1, 0.2], [0.0, 0.0, 0.0, 1e-3, 1e-3]])
def test_times_that_are_parted_grow_and_can_be_joined(times: list[float]) -> None:
    found = separate_equal_times(np.array(times))
    assert (np.diff(found) > 0.0).all()
    assert np.abs(found - times).max() < 1e-15
    assert np.array_equal(merge_equal_times(found), times)
